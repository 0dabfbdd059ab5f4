"""What a fit says about itself, without any truth.

Residuals alone are blind to what they cannot see: one wrong finger is one or two per cent of the
points, and a hidden finger tip has none. So residuals are looked at part by part, and the inverse
Hessian tells how well each vertex is determined at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models import BodyModel
from synthgen.models.joints import FINGERS
from synthgen.registration.correspondences import Pairs, closest
from synthgen.registration.patches import patches_of
from synthgen.registration.scan import Scan, nearest
from synthgen.registration.surface import Placed

Array = NDArray[np.float64]
PARTS = ("palm", *FINGERS)
NEAR_M, EVALUATED = 0.010, 20_000
LEAST_POINTS, COVERED_M = 60, 0.0025
# 95 % quantile over the median of a half-normal.
HALF_NORMAL = 2.906
# Standard errors that a small part's statistics are given.
DOUBT = 2.5
# Relative standard error of that quantile, times the root of the number of points.
QUANTILE_ERROR = 0.95
# A p95 below this is good whatever the median: the model's own limits, not the noise.
LEAST_P95_M = 5e-4


@dataclass(frozen=True, eq=False)
class Statistics:
    """Truth-free statistics of a fit; distances in metres.

    Attributes
    ----------
    explained : float
        Share of the points near the model that lie within ``limit_m`` of it and face alike.
    far : float
        Share of all points farther than 10 mm, open rims not counted.
    noise_m : float
        Standard deviation of the points about the surface.
    local_noise_m : float
        Their own scatter, about local planes: less than ``noise_m`` where the model misfits.
    counts : (6,)
        Points near each part (palm, index, middle, pinky, ring, thumb).
    unexplained : (6,) and p95_m : (6,)
        By part; NaN where a part has few points.
    ratios : (6,)
        By part, its p95 over the global median, 1 for normal noise, less 2.5 standard errors of
        that quantile (small parts have few points); NaN where a part has few points.
    biased : (6,)
        Share of a part's patches whose mean residual is no noise; NaN where it has few.
    coverage : (6,)
        Share of a part's vertices with a scan point within 2.5 mm that faces alike.
    tip_coverage : (6,)
        The same of each finger's last phalanx and the palm, by points that lie on that part.
    sd_m : (V,)
        Predicted standard deviation of each vertex.
    sd95_m : (6,)
        Its 95 % quantile by part.
    inflation : float
        How much less the points tell, because the model misfits: a factor of variances.
    pending : float
        Share of the energy that one more step promises to remove.
    """

    explained: float
    far: float
    limit_m: float
    noise_m: float
    local_noise_m: float
    rms_m: float
    counts: Array
    unexplained: Array
    p95_m: Array
    ratios: Array
    biased: Array
    coverage: Array
    tip_coverage: Array
    sd_m: Array
    sd95_m: Array
    inflation: float = 1.0
    pending: float = 0.0

    @property
    def worst_unexplained(self) -> float:
        """Largest unexplained share of a part."""
        return float(np.nanmax(self.unexplained, initial=0.0))

    @property
    def ratio(self) -> float:
        """Largest p95 of a part over the global median."""
        return float(np.nanmax(self.ratios, initial=0.0))

    @property
    def sd95_all_m(self) -> float:
        """95 % quantile of the predicted standard deviations of all vertices."""
        return float(np.quantile(self.sd_m, 0.95))

    def to_json(self) -> dict[str, Any]:
        """Return the statistics as JSON types."""
        by_part = {
            part: {
                "unexplained": _number(self.unexplained[k]),
                "p95_mm": _number(1e3 * self.p95_m[k]),
                "biased_patches": _number(self.biased[k]),
                "coverage": _number(self.coverage[k]),
                "tip_coverage": _number(self.tip_coverage[k]),
                "predicted_sd95_mm": _number(1e3 * self.sd95_m[k]),
            }
            for k, part in enumerate(PARTS)
        }
        return {
            "explained": self.explained,
            "far_share": self.far,
            "scan_to_mesh_rms_mm": 1e3 * self.rms_m,
            "noise_mm": 1e3 * self.noise_m,
            "local_noise_mm": 1e3 * self.local_noise_m,
            "pending_step": self.pending,
            "worst_part_unexplained": self.worst_unexplained,
            "worst_part_p95_ratio": self.ratio,
            "predicted_vertex_sd_mm": {
                "median": 1e3 * float(np.median(self.sd_m)),
                "p95": 1e3 * self.sd95_all_m,
            },
            "parts": by_part,
        }


def _number(value: float) -> float | None:
    return None if not np.isfinite(value) else float(value)


@lru_cache(maxsize=8)
def part_of_vertex(model: BodyModel) -> NDArray[np.int64]:
    """Return (V,) 0 for the palm, 1-5 for the finger that moves each vertex most."""
    joint = model.weights.argmax(axis=1)
    return np.where(joint == 0, 0, (joint + 2) // 3)


@lru_cache(maxsize=8)
def tips_of(model: BodyModel) -> tuple[NDArray[np.bool_], ...]:
    """Vertices (V,) of the palm, and of each finger's last phalanx, by part."""
    joint = model.weights.argmax(axis=1)
    return tuple(joint == 3 * k for k in range(len(PARTS)))


def statistics(
    placed: Placed,
    scan: Scan,
    covariance: Array,
    curved: float = 0.0,
    inflation: float = 1.0,
    last: Pairs | None = None,
    pending: float = 0.0,
) -> Statistics:
    """Compare a placed hand with a scan.

    ``covariance`` (n, n) is that of its parameters. ``last`` are the last stage's matches of the
    scan's leading points: where they are all of the scan, the comparison walks on from them.
    """
    points, normals = scan.points[-EVALUATED:], scan.normals[-EVALUATED:]
    pairs = closest(placed, points, normals, cut_m=NEAR_M, cosine=-2.0, curved=curved,
                    start=_corners(last, scan))  # fmt: skip
    distance = np.sqrt(pairs.squared)
    facing = np.sum(pairs.normal * normals, axis=1) > 0.3
    near = pairs.kept
    median = float(np.median(distance[near])) if near.any() else NEAR_M
    noise = median / 0.6745
    limit = max(1e-3, 4 * noise)
    bad = (distance > limit) | ~facing
    part = part_of_vertex(placed.surface.model)[pairs.corner]
    counts = np.bincount(part[near], minlength=len(PARTS)).astype(np.float64)
    unexplained, p95, ratios = (np.full(len(PARTS), np.nan) for _ in range(3))
    for k in range(len(PARTS)):
        own = near & (part == k)
        if counts[k] >= LEAST_POINTS:
            unexplained[k] = bad[own].mean()
            p95[k] = np.quantile(distance[own], 0.95)
            ratios[k] = p95[k] / max(HALF_NORMAL * median, LEAST_P95_M)
            ratios[k] -= DOUBT * QUANTILE_ERROR / np.sqrt(counts[k])
    inner = near & ~bad
    covered, shown = coverage(placed, scan)
    sd = predicted_sd(placed, covariance)
    by_vertex = part_of_vertex(placed.surface.model)
    patches = patches_of(placed, pairs, points, normals, noise)
    return Statistics(
        explained=float((~bad)[near].mean()) if near.any() else 0.0,
        far=float((~near & ~pairs.rim).mean()),
        limit_m=limit,
        noise_m=noise,
        local_noise_m=scan.local_noise_m,
        rms_m=float(np.sqrt(np.mean(distance[inner] ** 2))) if inner.any() else NEAR_M,
        counts=counts,
        unexplained=unexplained,
        p95_m=p95,
        ratios=ratios,
        biased=patches.biased_share(by_vertex, len(PARTS)),
        coverage=np.array([covered[by_vertex == k].mean() for k in range(len(PARTS))]),
        tip_coverage=np.array([shown[own].mean() for own in tips_of(placed.surface.model)]),
        sd_m=sd,
        sd95_m=np.array([np.quantile(sd[by_vertex == k], 0.95) for k in range(len(PARTS))]),
        inflation=inflation,
        pending=pending,
    )


def _corners(last: Pairs | None, scan: Scan) -> NDArray[np.int64] | None:
    if last is None or len(last.triangle) < len(scan.points):
        return None
    return last.corner[-EVALUATED:]


def coverage(placed: Placed, scan: Scan) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (V,) whether a scan point lies within 2.5 mm and faces alike, and whether of its part.

    A finger that was not scanned may be fitted beside another one's points.
    """
    distance, near = nearest(scan.tree, placed.vertices, 4 * COVERED_M)
    found = np.isfinite(distance)
    alike = np.zeros(len(distance), dtype=bool)
    alike[found] = np.sum(placed.normals[found] * scan.normals[near[found]], axis=1) > 0.3
    covered = np.flatnonzero(alike & (distance < COVERED_M))
    those, which = np.unique(near[covered], return_inverse=True)
    at = closest(placed, scan.points[those], scan.normals[those], cut_m=COVERED_M, cosine=-2.0)
    part = part_of_vertex(placed.surface.model)
    shown = covered[part[at.corner][which] == part[covered]]
    number = np.arange(len(part))
    return np.isin(number, covered), np.isin(number, shown)


def predicted_sd(placed: Placed, covariance: Array) -> Array:
    """Predict vertex standard deviations (V,), metres, from J C J^T."""
    slopes = placed.jacobian.reshape(-1, len(covariance))
    variance = np.sum((slopes @ covariance) * slopes, axis=1).reshape(-1, 3).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0)))


def early_explained(placed: Placed, scan: Scan, limit_m: float) -> float:
    """Share of points near the model within a limit: a cheap test of a half-finished fit."""
    points, normals = scan.points[-2000:], scan.normals[-2000:]
    pairs = closest(placed, points, normals, cut_m=0.03, cosine=-2.0)
    facing = np.sum(pairs.normal * normals, axis=1) > 0.3
    near = pairs.kept
    good = (pairs.squared < limit_m**2) & facing
    return float(good[near].mean()) if near.any() else 0.0
