"""Hands of a body begun afresh: many wrists and poses are tried on the forearm and hand alone.

A hand is a thicket of local minima: turned over, or every finger on its neighbour's points. The
part of the body below the elbow is a model of its own with an eighth of the vertices, so that a
hundred hypotheses can be tried at the price of a dozen steps of the whole body.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthgen.geometry.normals import unit
from synthgen.models import separate
from synthgen.models.joints import SIDES
from synthgen.registration.body_prior import BodyPriors, HandPriors
from synthgen.registration.body_schedule import MM, BodyStage, hand_crops, hand_vertices
from synthgen.registration.body_surface import BodyPlaced, BodySurface
from synthgen.registration.scan import Scan, nearest
from synthgen.registration.solver import Energy, Outcome, Trial, minimise
from synthgen.registration.terms import (
    GaussianPrior,
    GemanMcClure,
    MeshToScan,
    ScanToMesh,
    Term,
)

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
ROUGH = BodyStage(300, 6, 12 * MM, 60 * MM, 0.0, 3 * MM, 400, 0.1, 0.3, 60 * MM)
TIGHT = BodyStage(700, 8, 5 * MM, 30 * MM, 0.2, 2 * MM, 1200, 0.05, 0.3, 30 * MM)
LOOK = replace(ROUGH, points=150)
REFINED, TIGHTENED, FEW_POINTS, MARGIN_M = 6, 3, 40, 0.08
LOOKED = 8
# A hand is where it should be if few of its points are off the skin, and little skin is off them;
# where there is hardly a hand, a search finds nothing.
OFF_M, OFF, UNCOVERED_M, UNCOVERED = 0.006, 0.10, 0.010, (0.10, 0.60)
# Turns of the forearm about its bone and of the wrist about its y and z axes, radians.
ARMS = (
    (0.0, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, -0.3, 0.0), (0.0, 0.0, 0.4), (0.0, 0.0, -0.4),
    (0.8, 0.0, 0.0), (-0.8, 0.0, 0.0), (1.6, 0.0, 0.0), (-1.6, 0.0, 0.0),
)  # fmt: skip
ASIDE = (-0.25, 0.25)


@dataclass(frozen=True, eq=False)
class HandPart:
    """Forearm and hand of one side as a surface of its own; or the whole arm.

    Attributes
    ----------
    surface : BodySurface
        Of the part.
    vertices : (V',) int64
        Of the body.
    columns : (n',) int64
        Of the body's vector: the part's vector is ``x[columns]``.
    shoulder : slice or None
        Of the part's vector; None: the upper arm is no part of it.
    elbow, wrist, hand : slice
        Of the part's vector.
    bone : (3,)
        From elbow to wrist at rest.
    looked : (m,) int64
        Some vertices, of the part: of the hand, or of the whole arm.
    """

    surface: BodySurface
    vertices: Ids
    columns: Ids
    shoulder: slice | None
    elbow: slice
    wrist: slice
    hand: slice
    bone: Array
    looked: Ids

    @property
    def arm(self) -> Ids:
        """Angles of the arm in the part's vector, wrist included."""
        first = [] if self.shoulder is None else [np.r_[self.shoulder]]
        return np.concatenate([*first, np.r_[self.elbow], np.r_[self.wrist]])


@lru_cache(maxsize=16)
def hand_part(surface: BodySurface, side: str, whole_arm: bool = False) -> HandPart:
    """Separate forearm and hand from a body, or the whole arm."""
    model = surface.model
    own = np.zeros(surface.n_vertices, dtype=bool)
    own[hand_vertices(surface, side)] = True
    looked = own.copy()
    bones = ("shoulder", "elbow") if whole_arm else ("elbow",)
    joints = [model.joint_names.index(f"{side}_{name}") for name in bones]
    own |= np.isin(model.weights.argmax(axis=1), joints)
    if whole_arm:
        looked = own
    ids = np.flatnonzero(own)
    part = separate(model, ids)
    small = BodySurface(part.model)
    pose = surface.pose.start + 3 * part.joint_ids[:, None] + np.arange(3)
    columns = [np.r_[surface.shape], pose.ravel(), np.r_[surface.translation]]
    if part.model.n_expression:
        columns.append(np.r_[surface.expression])
    elbow, wrist = small.joint(f"{side}_elbow"), small.joint(f"{side}_wrist")
    _, rest = model.shaped(np.zeros(model.n_shape))
    ends = [model.joint_names.index(f"{side}_{name}") for name in ("elbow", "wrist")]
    return HandPart(
        surface=small,
        vertices=ids,
        columns=np.concatenate(columns).astype(np.int64),
        shoulder=small.joint(f"{side}_shoulder") if whole_arm else None,
        elbow=elbow,
        wrist=wrist,
        hand=small.hands[side],
        bone=unit(rest[ends[1]] - rest[ends[0]]),
        looked=np.flatnonzero(looked[ids])[::LOOKED],
    )


def begun_afresh(priors: BodyPriors, scan: Scan, x: Array, side: str, refined: int = 0) -> Array:
    """Return x with the best elbow, wrist and fingers found for one hand; x if it has no points.

    The search is left out where the hand lies well; with ``refined`` it is made in any case, and
    that many hypotheses are refined.
    """
    part = hand_part(priors.surface, side)
    points = _own_points(priors.surface.at(x), scan, side)
    if len(points) < FEW_POINTS:
        return x
    own = Scan(scan.points[points], scan.normals[points])
    hand = priors.hands[side]
    y = x[part.columns]
    known = arm_priors(priors, part, hand)
    tight, few, more = part_energy(part, own, TIGHT, known), hand.components, hand.more
    best = lowered(tight, part, y, TIGHT, more)
    if refined or _is_lost(part, best.trial):
        look, rough = (part_energy(part, own, stage, known) for stage in (LOOK, ROUGH))
        tried = sorted(_hypotheses(part, hand, y), key=lambda v: look.at(v).cost)
        ends = [lowered(rough, part, v, ROUGH, few) for v in tried[: refined or REFINED]]
        ends.sort(key=lambda outcome: outcome.trial.cost)
        last = [
            lowered(tight, part, o.x, TIGHT, more) for o in ends[: max(refined // 2, TIGHTENED)]
        ]
        best = min([best, *last], key=lambda outcome: outcome.trial.cost)
    result = x.copy()
    result[part.columns] = best.x
    return result


def lowered(energy: Energy, part: HandPart, y: Array, stage: BodyStage, fingers: Array) -> Outcome:
    """Lower the energy of an arm whose fingers move along some directions (45, k)."""
    basis = _basis(part, fingers)
    return minimise(energy, y, iterations=stage.iterations, basis=basis, damping=1e-3)


def _is_lost(part: HandPart, trial: Trial) -> bool:
    """Tell whether a hand should be looked for elsewhere."""
    pairs, (_, squared, _) = trial.matches[:2]
    off = (pairs.squared > OFF_M**2) | ~pairs.kept
    bare = float((squared > UNCOVERED_M**2).mean())
    return bool(off[~pairs.rim].mean() > OFF) or UNCOVERED[0] < bare < UNCOVERED[1]


def _own_points(placed: BodyPlaced, scan: Scan, side: str) -> Ids:
    """Points around a hand that are nearer to it or its forearm than to other skin."""
    surface = placed.surface
    crop = hand_crops(placed, scan, MARGIN_M)[SIDES.index(side)]
    joint = surface.model.joint_names.index(f"{side}_elbow")
    own = surface.model.weights.argmax(axis=1) == joint
    own[hand_vertices(surface, side)] = True
    _, near = nearest(placed.tree, scan.points[crop])
    return np.asarray(crop[own[near]])


def arm_priors(priors: BodyPriors, part: HandPart, hand: HandPriors) -> list[Term]:
    """Return the priors of arm and fingers."""
    fingers = [replace(term, where=part.hand) for term in (hand.mixture, hand.complement)]
    return [arm_prior(priors, part), *fingers]


def arm_prior(priors: BodyPriors, part: HandPart) -> GaussianPrior:
    """Return the prior of the arm's angles."""
    among = np.searchsorted(priors.joints, part.columns[part.arm])
    return GaussianPrior(part.arm, priors.start[part.columns[part.arm]], priors.sd[among])


def part_energy(part: HandPart, own: Scan, stage: BodyStage, priors: list[Term]) -> Energy:
    """Return the energy of a part over its own points."""
    points, normals = own.points[: stage.points], own.normals[: stage.points]
    weight, rho = stage.n_eff / stage.noise_m**2, GemanMcClure(stage.sigma_m)
    data = ScanToMesh(points, normals, weight, rho, stage.cut_m, stage.cosine, stage.tangential,
                      tied=100)  # fmt: skip
    skin = MeshToScan(own, weight * stage.mesh_to_scan, rho, stage.mesh_cut_m,
                      max(stage.cosine, 0.2), some=part.looked)  # fmt: skip
    return Energy(part.surface, [data, skin, *priors])


def _basis(part: HandPart, fingers: Array) -> Array:
    """Directions of the arm's joints and some finger components."""
    arm = part.arm
    basis = np.zeros((part.surface.n, len(arm) + fingers.shape[1]))
    basis[arm, np.arange(len(arm))] = 1
    basis[part.hand, len(arm) :] = fingers
    return basis


def _hypotheses(part: HandPart, hand: HandPriors, y: Array) -> Iterator[Array]:
    """Yield vectors with each of some arms and typical poses."""
    for arm in _arms(part, y):
        for pose in [y[part.hand], *hand.typical]:
            other = arm.copy()
            other[part.hand] = pose
            yield other


def _arms(part: HandPart, y: Array) -> Iterator[Array]:
    """Yield the arm as it is, with the wrist turned aside, and with forearm and wrist set anew."""
    yield y
    wrist, elbow = Rotation.from_rotvec(y[part.wrist]), Rotation.from_rotvec(y[part.elbow])
    for angle in ASIDE:
        other = y.copy()
        other[part.wrist] = (wrist * Rotation.from_rotvec([0, angle, 0])).as_rotvec()
        yield other
    q = elbow.as_quat()
    twist = 2 * np.arctan2(q[:3] @ part.bone, q[3])
    swing = elbow * Rotation.from_rotvec(-twist * part.bone)
    for turn, side, bend in ARMS:
        other = y.copy()
        other[part.elbow] = (swing * Rotation.from_rotvec(turn * part.bone)).as_rotvec()
        other[part.wrist] = (0.0, side, bend)
        yield other
