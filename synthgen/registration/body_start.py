"""Where a body's fit begins: upright, turned about the vertical, as tall as the scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from synthgen.registration.body_prior import BodyPriors
from synthgen.registration.scan import Scan

Array = NDArray[np.float64]
LOOK, ARM_M, ENDS = 5000, 1.0, (0.004, 0.996)
MOST_SD, LEAST_SLOPE_M = 2.5, 0.01


def yaws(scan: Scan) -> tuple[float, float]:
    """Return the two turns about y that lay the template's arms along the scan's (radians).

    Seen from above, the arms of an A-pose are the longest spread of the points.
    """
    flat = scan.points[:LOOK][:, [0, 2]]
    flat = flat - np.median(flat, axis=0)
    flat = flat[np.linalg.norm(flat, axis=1) < ARM_M]
    axis = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)[2][0]
    turn = float(np.arctan2(-axis[1], axis[0]))
    return turn, turn + np.pi


def spread_yaws(count: int = 8) -> list[float]:
    """Return turns all around, for scans whose arms are not the longest spread."""
    return [2 * np.pi * k / count for k in range(count)]


def starts(priors: BodyPriors, scan: Scan, turns: Sequence[float]) -> list[Array]:
    """Return vectors (n,): the A-pose of the scan's height at each turn, over its middle."""
    s = priors.surface
    some = _core(scan)
    low, high = np.quantile(some[:, 1], ENDS)
    base = priors.start.copy()
    base[s.shape.start] = _first_beta(priors, float(high - low))
    result = []
    for turn in turns:
        x = base.copy()
        x[s.root] = (0.0, turn, 0.0)
        v = s.at(x).vertices
        middle = np.median(some, axis=0) - np.median(v, axis=0)
        middle[1] = (low + high) / 2 - (v[:, 1].min() + v[:, 1].max()) / 2
        x[s.translation] = middle
        result.append(x)
    return result


def _core(scan: Scan) -> Array:
    """Take some points, without those far from the rest."""
    some = scan.points[:LOOK]
    distance = np.linalg.norm(some - np.median(some, axis=0), axis=1)
    return np.asarray(some[distance < 2.8 * np.median(distance)])


def _first_beta(priors: BodyPriors, height_m: float) -> float:
    """Return the first shape coefficient of a height, which it governs in all such models."""
    s = priors.surface
    taller = priors.start.copy()
    taller[s.shape.start] = 1.0
    own, other = (float(np.ptp(s.at(x).vertices[:, 1])) for x in (priors.start, taller))
    slope = other - own
    if abs(slope) < LEAST_SLOPE_M:
        return 0.0
    return float(np.clip((height_m - own) / slope, -MOST_SD, MOST_SD))
