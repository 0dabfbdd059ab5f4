"""Coarse-to-fine stages of a body's fit: what each looks at, and which parameters are free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.models.joints import SIDES
from synthgen.registration.body_prior import STILL, BodyPriors
from synthgen.registration.body_surface import BodyPlaced, BodySurface
from synthgen.registration.inspection import LEAST_POINTS
from synthgen.registration.scan import Scan, nearest
from synthgen.registration.schedule import Stage
from synthgen.registration.solver import Energy, Outcome, minimise
from synthgen.registration.terms import GemanMcClure, MeshToScan, ScanToMesh, Term
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Free = Literal["rigid", "body", "pca", "all"]
MM = 1e-3
ANYWHERE_M = 1e3
# Search trees of bodies need more points than those of hands.
TREE_POINTS = 40_000
MARGIN_M, TIED = 0.06, 300
# Stages so fine take small steps: matches walk on from the last ones.
WALK_SIGMA_M = 6e-3


@dataclass(frozen=True)
class BodyStage(Stage):
    """One stage; see :class:`synthgen.registration.schedule.Stage`.

    Attributes
    ----------
    hand_points : int
        Points near each predicted hand besides: a hand is one or two per cent of a scan.
    looked : int
        Vertices of mesh-to-scan, and a quarter as many of the hands.
    free : "rigid", "body", "pca" or "all"
        Placement and size; all but the hands; hands in six components; everything.
    betas : int or None
        Shape coefficients that are free; None: all.
    hand_noise_m : float
        Standard deviation of hands' points where these weigh apart; see :func:`body_terms`.
    """

    hand_points: int = 0
    looked: int = 400
    free: Free = "all"
    betas: int | None = None
    hand_noise_m: float = 1.2 * MM


RIGID = BodyStage(400, 8, 120 * MM, ANYWHERE_M, -0.3, 10 * MM, 40, 0.5, 0.5, ANYWHERE_M,
                  looked=300, free="rigid", betas=1)  # fmt: skip
LOOSE = BodyStage(700, 10, 60 * MM, ANYWHERE_M, 0.0, 8 * MM, 150, 0.3, 0.5, ANYWHERE_M,
                  looked=400, free="body", betas=5)  # fmt: skip
WIDE = BodyStage(1500, 10, 30 * MM, 150 * MM, 0.1, 5 * MM, 600, 0.1, 0.3, 150 * MM,
                 looked=500, free="body", betas=16)  # fmt: skip
CLOSE = BodyStage(2000, 10, 15 * MM, 60 * MM, 0.2, 3 * MM, 1500, 0.05, 0.2, 60 * MM,
                  hand_points=300, looked=500, free="pca", betas=16)  # fmt: skip
NEAR = BodyStage(3000, 10, 6 * MM, 25 * MM, 0.4, 2 * MM, 3000, 0.02, 0.1, 25 * MM,
                 hand_points=600, looked=500, free="pca")  # fmt: skip
FINE = BodyStage(6000, 10, 3 * MM, 12 * MM, 0.5, 1 * MM, 6000, hand_points=1500, free="pca")
# Hands are scanned worse than the rest: smoothed, they would make the whole body thin. The shape is
# that of the points farther from them; of the last stage these are a term of their own. Both stages
# take the scan's own noise (:func:`last_stage`): weighed as 1 mm, a scan of 0.2 mm lets
# priors and hands pull the body off by more than its points do.
SHAPE, HANDS_M = BodyStage(8000, 4, 3 * MM, 12 * MM, 0.5, 1 * MM, 8000), 0.02
LAST = replace(FINE, points=SHAPE.points, n_eff=SHAPE.n_eff + 2 * FINE.hand_points, iterations=6,
               free="all", betas=0)  # fmt: skip


def basis_of(priors: BodyPriors, stage: BodyStage) -> Array:
    """Directions (n, p) that a stage searches."""
    s = priors.surface
    betas = s.model.n_shape if stage.betas is None else min(stage.betas, s.model.n_shape)
    shape = np.arange(s.shape.start, s.shape.start + betas)
    root = np.r_[s.root, s.translation]
    if stage.free == "rigid":
        return np.eye(s.n)[:, np.r_[root, shape]]
    free = [root, shape, priors.joints if stage.free == "all" else _outer(priors)]
    if stage.free == "all" or stage.betas is None:
        free.append(np.r_[s.expression].astype(np.int64))
    columns = [np.eye(s.n)[:, np.concatenate(free)]]
    for side in SIDES if stage.free in ("pca", "all") else ():
        hand = np.zeros(
            (s.n, 45 if stage.free == "all" else priors.hands[side].components.shape[1])
        )
        hand[s.hands[side]] = np.eye(45) if stage.free == "all" else priors.hands[side].components
        columns.append(hand)
    return np.concatenate(columns, axis=1)


def shape_basis(priors: BodyPriors) -> Array:
    """Directions (n, p) of ``SHAPE``: without fingers and wrists, whose points it does not see."""
    s, basis = priors.surface, basis_of(priors, SHAPE)
    held = [np.r_[at] for side in SIDES for at in (s.hands[side], s.joint(f"{side}_wrist"))]
    return basis[:, ~basis[np.concatenate(held)].any(axis=0)]


def _outer(priors: BodyPriors) -> Ids:
    """Joint angles without those of toes and jaw, which only the last stage can tell."""
    s = priors.surface
    inner = [name for name in s.model.joint_names if "toe" in name or name in ("jaw", *STILL)]
    small = np.concatenate([np.zeros(0, np.int64), *(np.r_[s.joint(n)] for n in inner)])
    return priors.joints[~np.isin(priors.joints, small)]


@lru_cache(maxsize=8)
def looked_at(surface: BodySurface) -> tuple[Ids, Ids]:
    """Vertices in random order: all, and those of the hands."""
    rng = stream(0, "corpus", 0, 0, "body vertices")
    order = rng.permutation(surface.n_vertices)
    hands = np.concatenate([hand_vertices(surface, side) for side in SIDES])
    return order, rng.permutation(hands)


@lru_cache(maxsize=16)
def hand_vertices(surface: BodySurface, side: str) -> Ids:
    """Vertices that the wrist and finger joints of a side move most."""
    names = surface.model.joint_names
    first = (surface.hands[side].start - surface.pose.start) // 3
    own = [names.index(f"{side}_wrist"), *range(first, first + 15)]
    return np.flatnonzero(np.isin(surface.model.weights.argmax(axis=1), own))


def hand_crops(placed: BodyPlaced, scan: Scan, margin_m: float = MARGIN_M) -> tuple[Ids, Ids]:
    """Points within a margin of each predicted hand (left, right), in the scan's random order."""
    left, right = (_crop(placed.vertices[hand_vertices(placed.surface, side)], scan, margin_m)
                   for side in SIDES)  # fmt: skip
    return left, right


def without_hands(placed: BodyPlaced, scan: Scan) -> Scan | None:
    """Return the points that are no hand's; None if there are hardly any."""
    others = np.ones(len(scan.points), dtype=bool)
    others[np.concatenate(hand_crops(placed, scan, HANDS_M))] = False
    if others.sum() < LEAST_POINTS:
        return None
    return replace(scan, points=scan.points[others], normals=scan.normals[others])


def _crop(hand: Array, scan: Scan, margin_m: float) -> Ids:
    low, high = hand.min(axis=0) - margin_m, hand.max(axis=0) + margin_m
    inside = np.arange(len(scan.points))
    for axis in range(3):  # each look is at what the one before left
        value = scan.points[inside, axis]
        inside = inside[(value > low[axis]) & (value < high[axis])]
    inside = inside[:4000]
    distance, _ = nearest(cKDTree(hand[::3]), scan.points[inside], margin_m)
    return inside[np.isfinite(distance)]


def body_terms(
    surface: BodySurface,
    scan: Scan,
    stage: BodyStage,
    priors: Sequence[Term],
    crops: Sequence[Ids] = (),
    others: Scan | None = None,
) -> list[Term]:
    """Return the terms of a stage; ``crops`` are points near hands, of which each gives some.

    Where the points that are no hand's are known, ``others``, hands are a second term with a noise
    of their own.
    """
    hands = np.concatenate([np.zeros(0, np.int64), *(c[: stage.hand_points] for c in crops)])
    rest = scan if others is None else others
    body = np.arange(min(stage.points, len(rest.points)))
    if others is None:
        own = [(scan, np.concatenate([body, hands]), stage.noise_m)]
    else:
        own = [(rest, body, stage.noise_m), (scan, hands, max(stage.noise_m, stage.hand_noise_m))]
    each = stage.n_eff / (stage.points + len(crops) * stage.hand_points)
    data = [_scan_to_mesh(stage, s, ids, each / noise_m**2) for s, ids, noise_m in own if len(ids)]
    terms: list[Term] = [*data]
    if stage.mesh_to_scan > 0:
        order, seen = looked_at(surface)
        some = order[: stage.looked]
        if stage.hand_points:
            some = np.concatenate([some, seen[: stage.looked // 4]])
        weight = stage.mesh_to_scan * sum(term.weight for term in data)
        terms.append(MeshToScan(scan, weight, GemanMcClure(stage.sigma_m), stage.mesh_cut_m,
                                max(stage.cosine, 0.2), some=some))  # fmt: skip
    return [*terms, *priors]


def _scan_to_mesh(stage: BodyStage, scan: Scan, ids: Ids, each: float) -> ScanToMesh:
    """Return the term of some points, each of which weighs as much."""
    walking: dict[str, Ids] | None = {} if stage.sigma_m <= WALK_SIGMA_M else None
    return ScanToMesh(scan.points[ids], scan.normals[ids], each * len(ids),
                      GemanMcClure(stage.sigma_m), stage.cut_m, stage.cosine, stage.tangential,
                      tied=TIED, memory=walking)  # fmt: skip


def run_body_stage(
    surface: BodySurface,
    scan: Scan,
    x: Array,
    stage: BodyStage,
    priors: Sequence[Term],
    basis: Array | None,
    crops: Sequence[Ids] = (),
    others: Scan | None = None,
) -> Outcome:
    """Run one stage from x."""
    energy = Energy(surface, body_terms(surface, scan, stage, priors, crops, others))
    return minimise(energy, x, iterations=stage.iterations, basis=basis, damping=1e-3)


def logged(stage: BodyStage, outcome: Outcome, cpu_s: float) -> dict[str, Any]:
    """One stage for the report."""
    return {
        "points": stage.points, "hand_points": stage.hand_points, "free": stage.free,
        "sigma_mm": 1e3 * stage.sigma_m, "noise_mm": 1e3 * stage.noise_m,
        "steps": outcome.iterations, "stopped": outcome.reason,
        "cost": outcome.trial.cost, "cpu_s": cpu_s,
    }  # fmt: skip
