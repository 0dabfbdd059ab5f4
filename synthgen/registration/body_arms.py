"""Arms of a body begun afresh: in free poses an arm may lie where there is none of its points.

Coarse steps of the whole body start at the A-pose and pull each arm to the nearest points, which an
arm that is raised or bent leaves behind. The points that lie on no other skin are then that arm's:
many poses of the arm alone are tried on them, the best refined.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.models.joints import SIDES
from synthgen.registration.body_hands import (
    FEW_POINTS,
    HandPart,
    arm_prior,
    arm_priors,
    hand_part,
    lowered,
    part_energy,
)
from synthgen.registration.body_prior import BodyPriors
from synthgen.registration.body_schedule import MM, BodyStage
from synthgen.registration.body_surface import BodyPlaced
from synthgen.registration.scan import Scan, nearest
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
WIDE = BodyStage(300, 8, 60 * MM, 400 * MM, -0.3, 8 * MM, 100, 0.3, 0.5, 400 * MM)
MIDDLE = BodyStage(400, 8, 25 * MM, 150 * MM, 0.0, 4 * MM, 300, 0.1, 0.4, 150 * MM)
TIGHT = BodyStage(700, 8, 10 * MM, 60 * MM, 0.2, 2 * MM, 1000, 0.05, 0.3, 60 * MM)
LOOK = replace(WIDE, points=150)
# Poses drawn, and how many of them each stage refines.
DRAWN, REFINED = 60, (8, 4, 2)
# An arm's points: so far from the shoulder at most, so far from other skin at least.
REACH_M, AWAY_M = 0.9, 0.03
# An arm is lost if so much of its skin is so far from points, and so many points from its skin. Of
# eight lost arms 6-82 % and 40-57 %; of others no skin, and (outliers) 5-13 % of the points.
BARE_M, BARE, OFF_M, OFF = 0.04, 0.04, 0.05, 0.2


def arm_begun_afresh(
    priors: BodyPriors, scan: Scan, x: Array, side: str, *, surely: bool = False
) -> Array:
    """Return x with the best arm and fingers found for one side; x if it has no points.

    The search is left out where the arm lies on points, unless ``surely``.
    """
    part, hand = hand_part(priors.surface, side, True), priors.hands[side]
    placed = priors.surface.at(x)
    own = _own_points(placed, scan, part, side)
    if len(own.points) < FEW_POINTS or not (surely or _is_lost(placed, scan, part, own)):
        return x
    known = arm_priors(priors, part, hand)
    look = part_energy(part, own, LOOK, known)
    tried = sorted(_hypotheses(priors, part, x, side), key=lambda v: look.at(v).cost)
    none = hand.components[:, :0]
    stages = ((WIDE, none), (MIDDLE, hand.components), (TIGHT, hand.components))
    for (stage, fingers), count in zip(stages, REFINED, strict=True):
        energy = part_energy(part, own, stage, known)
        ends = [lowered(energy, part, v, stage, fingers) for v in tried[:count]]
        tried = [end.x for end in sorted(ends, key=lambda end: end.trial.cost)]
    result = x.copy()
    result[part.columns] = tried[0]
    return result


def _is_lost(placed: BodyPlaced, scan: Scan, part: HandPart, own: Scan) -> bool:
    """Tell whether skin of an arm is bare, and points that may be its own lie off it.

    Where a hand was not scanned there are no such points; where the other arm is lost they are
    that arm's, and no skin is bare.
    """
    bare = nearest(scan.tree, placed.vertices[part.vertices[part.looked]], BARE_M)[0]
    if np.isinf(bare).mean() < BARE:
        return False
    off = nearest(cKDTree(placed.vertices[part.vertices]), own.points, OFF_M)[0]
    return bool(np.isinf(off).mean() > OFF)


def _own_points(placed: BodyPlaced, scan: Scan, part: HandPart, side: str) -> Scan:
    """Points within an arm's reach of the shoulder that lie on no other skin."""
    joint = placed.surface.model.joint_names.index(f"{side}_shoulder")
    some = scan.points[: scan.tree_points]
    near = np.flatnonzero(np.linalg.norm(some - placed.joints[joint], axis=1) < REACH_M)
    others = np.delete(placed.vertices, part.vertices, axis=0)
    distance, _ = nearest(cKDTree(others), some[near], AWAY_M)
    own = near[np.isinf(distance)]
    return Scan(scan.points[own], scan.normals[own])


def _hypotheses(priors: BodyPriors, part: HandPart, x: Array, side: str) -> list[Array]:
    """Return vectors of the part: the arm as it is, and drawn from its prior with a mean hand."""
    prior = arm_prior(priors, part)
    rng = stream(0, "corpus", SIDES.index(side), 0, "arms")
    result = [x[part.columns]]
    for _ in range(DRAWN):
        drawn = result[0].copy()
        drawn[part.arm] = prior.mean + prior.sd * rng.standard_normal(len(part.arm))
        drawn[part.hand] = priors.hands[side].mean
        result.append(drawn)
    return result
