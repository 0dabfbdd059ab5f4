"""What a body's fit says about itself, part by part: a hand is one or two per cent of a scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models import BodyModel
from synthgen.registration.body_schedule import hand_crops, looked_at
from synthgen.registration.body_surface import BodyPlaced, BodySurface
from synthgen.registration.correspondences import closest
from synthgen.registration.scan import Scan, nearest
from synthgen.registration.verdict import Judgement

Array = NDArray[np.float64]
PARTS = (
    "torso", "head", "left_arm", "right_arm", "left_hand", "right_hand", "left_leg", "right_leg",
    "left_foot", "right_foot",
)  # fmt: skip
_WORDS = {"head": ("neck", "head", "jaw", "eye"), "arm": ("shoulder", "elbow"),
          "leg": ("hip", "knee"), "foot": ("ankle", "foot", "toe"),
          "torso": ("pelvis", "spine", "collar")}  # fmt: skip
NEAR_M, EVALUATED, LEAST_POINTS, FACING = 0.05, 12_000, 60, 0.0
NEIGHBOURS, COVERED_M = 4, 0.010
SD_HANDS, SD_OTHERS = 3, 8
# Gates. Scans of hands are smoothed and webbed: points between fingers lie up to 4 mm off the
# skin, with any normal, but no farther; one wrong finger of ten has 3 % of a hand's points.
LIMIT_M, UNEXPLAINED, EXPLAINED = 2e-3, 0.05, 0.93
HAND_LIMIT_M, HAND_UNEXPLAINED = 4e-3, 0.02
# Where the shape lies outside the model, residuals are no longer like noise.
MISFIT, MISFIT_UNEXPLAINED = 1.3, 0.15
# With less of a hand than this, what is left explains itself in more than one way.
HAND_COVERED = 0.65
FAR, NOISE_M, SHAPE_SD = 0.2, 4e-3, 4.0
# Heads have inner parts that nobody sees: mouth, eyes.
SD95_M, HAND_SD95_M, SD_PER_NOISE = 4e-3, 4e-3, 3.0


@dataclass(frozen=True, eq=False)
class BodyStatistics:
    """Truth-free statistics of a body's fit; distances in metres.

    Attributes
    ----------
    explained : float
        Share of the points within 50 mm of the skin that lie within ``limit_m`` and face alike;
        hands have a limit of their own and no normals.
    far : float
        Share of all points farther than that.
    noise_m : float
        Standard deviation of the points about the skin.
    local_noise_m : float
        Their own scatter, about local planes: less than ``noise_m`` where the model misfits.
    points : (10,) int
        Points looked at, by part; more than their share for hands.
    unexplained, p95_m, coverage, sd95_m : (10,)
        By part: NaN where it has few points; the share of its vertices with a scan point within
        10 mm that faces alike; the 95 % quantile of the predicted standard deviations.
    sd_m : (V,)
        Predicted standard deviation of each vertex.
    """

    explained: float
    far: float
    limit_m: float
    noise_m: float
    local_noise_m: float
    points: NDArray[np.int64]
    unexplained: Array
    p95_m: Array
    coverage: Array
    sd95_m: Array
    sd_m: Array

    def to_json(self) -> dict[str, Any]:
        """Return the statistics as JSON types."""
        by_part = {
            part: {
                "points": int(self.points[k]),
                "unexplained": _number(self.unexplained[k]),
                "p95_mm": _number(1e3 * self.p95_m[k]),
                "coverage": float(self.coverage[k]),
                "predicted_sd95_mm": float(1e3 * self.sd95_m[k]),
            }
            for k, part in enumerate(PARTS)
        }
        return {
            "explained": self.explained,
            "far_share": self.far,
            "limit_mm": 1e3 * self.limit_m,
            "noise_mm": 1e3 * self.noise_m,
            "local_noise_mm": 1e3 * self.local_noise_m,
            "predicted_vertex_sd_mm": {
                "median": 1e3 * float(np.median(self.sd_m)),
                "p95": 1e3 * float(np.quantile(self.sd_m, 0.95)),
            },
            "parts": by_part,
        }


def _number(value: float) -> float | None:
    return None if not np.isfinite(value) else float(value)


@lru_cache(maxsize=8)
def part_of_vertex(model: BodyModel) -> NDArray[np.int64]:
    """Return (V,) the part of ``PARTS`` to which the joint belongs that moves a vertex most."""
    own = np.array([PARTS.index(_part(name)) for name in model.joint_names])
    return np.asarray(own[model.weights.argmax(axis=1)])


def _part(joint: str) -> str:
    kind = next((k for k, words in _WORDS.items() if any(w in joint for w in words)), "hand")
    return kind if kind in PARTS else f"{joint.split('_')[0]}_{kind}"


def body_statistics(placed: BodyPlaced, scan: Scan, covariance: Array) -> BodyStatistics:
    """Compare a placed body with a scan; ``covariance`` (n, n) is that of its parameters."""
    crops = hand_crops(placed, scan)
    ids = np.concatenate([np.arange(len(scan.points))[-EVALUATED:], *(c[-1500:] for c in crops)])
    points, normals = scan.points[ids], scan.normals[ids]
    pairs = closest(placed, points, normals, cut_m=NEAR_M, cosine=-2.0, neighbours=NEIGHBOURS)
    distance, near = np.sqrt(pairs.squared), pairs.kept
    uniform = np.arange(len(ids)) < min(EVALUATED, len(scan.points))
    plain = near & uniform
    noise = float(np.median(distance[plain])) / 0.6745 if plain.any() else NEAR_M
    limit = max(LIMIT_M, 4 * noise)
    by_vertex = part_of_vertex(placed.surface.model)
    part = by_vertex[pairs.triangle[np.arange(len(ids)), pairs.barycentric.argmax(axis=1)]]
    hand = np.isin(part, [k for k, name in enumerate(PARTS) if "hand" in name])
    away = (np.sum(pairs.normal * normals, axis=1) < FACING) & ~hand
    bad = away | (distance > np.where(hand, max(HAND_LIMIT_M, limit), limit))
    unexplained, p95 = np.full((2, len(PARTS)), np.nan)
    for k in range(len(PARTS)):
        own = near & (part == k)
        if own.sum() >= LEAST_POINTS:
            unexplained[k], p95[k] = bad[own].mean(), np.quantile(distance[own], 0.95)
    covered, sd = coverage(placed, scan), predicted_sd(placed, covariance)
    return BodyStatistics(
        explained=float((~bad)[plain].mean()) if plain.any() else 0.0,
        far=float((~near)[uniform].mean()),
        limit_m=limit,
        noise_m=noise,
        local_noise_m=scan.local_noise_m,
        points=np.bincount(part[near], minlength=len(PARTS)),
        unexplained=unexplained,
        p95_m=p95,
        coverage=np.array([covered[by_vertex == k].mean() for k in range(len(PARTS))]),
        sd95_m=np.array([np.quantile(sd[by_vertex == k], 0.95) for k in range(len(PARTS))]),
        sd_m=sd,
    )


def coverage(placed: BodyPlaced, scan: Scan) -> NDArray[np.bool_]:
    """Return (V,) whether a scan point lies within 10 mm and faces alike."""
    distance, near = nearest(scan.tree, placed.vertices, COVERED_M)
    found = np.isfinite(distance)
    result = np.zeros(len(distance), dtype=bool)
    alike = np.sum(placed.normals[found] * scan.normals[near[found]], axis=1)
    result[found] = alike > 0.3
    return result


def predicted_sd(placed: BodyPlaced, covariance: Array) -> Array:
    """Predict vertex standard deviations (V,), metres, from J C J^T at some vertices."""
    some, of_vertex = _sampled(placed.surface)
    variance = np.zeros(len(some))
    for axis in range(3):
        along = np.tile(np.eye(3)[axis], (len(some), 1))
        rows = placed.vertex_rows(some, along)
        variance += np.sum((rows @ covariance) * rows, axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0))[of_vertex])


@lru_cache(maxsize=8)
def _sampled(surface: BodySurface) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Choose some vertices, dense on hands, and for every vertex the nearest of them at rest."""
    from scipy.spatial import cKDTree

    order, hands = looked_at(surface)
    some = np.unique(np.concatenate([order[::SD_OTHERS], hands[::SD_HANDS]]))
    rest = surface.model.v_template
    return some, nearest(cKDTree(rest[some]), rest)[1]


def judge_body(s: BodyStatistics, shape: Array) -> Judgement:
    """Judge one finished fit."""
    misfit = s.noise_m > MISFIT * max(s.local_noise_m, LIMIT_M / 4)
    others = MISFIT_UNEXPLAINED if misfit else UNEXPLAINED
    limits = np.array([HAND_UNEXPLAINED if "hand" in part else others for part in PARTS])
    bad = tuple(part for part, u, limit in zip(PARTS, s.unexplained, limits, strict=True)
                if u > limit)  # fmt: skip
    if s.far > FAR:
        return Judgement("fail", "background")
    if s.explained < EXPLAINED or len(bad) > 4:
        return Judgement("fail", "cold_start_failed")
    if s.noise_m > NOISE_M:
        return Judgement("fail", "noise_above_spec")
    if bad:
        return Judgement("fail", "part_missed", bad)
    if np.abs(shape).max(initial=0.0) > SHAPE_SD:
        return Judgement("fail", "shape_limit")
    hidden = tuple(part for k, part in enumerate(PARTS) if _is_hidden(s, k))
    return Judgement("unobserved", "hole", hidden) if hidden else Judgement("pass")


def _is_hidden(s: BodyStatistics, part: int) -> bool:
    """Tell whether the scan does not determine a part."""
    hand = "hand" in PARTS[part]
    limit = max(HAND_SD95_M if hand else SD95_M, SD_PER_NOISE * s.noise_m)
    return bool(s.sd95_m[part] > limit or (hand and s.coverage[part] < HAND_COVERED))
