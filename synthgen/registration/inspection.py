"""Looking at a scan before fitting: one hand or body, in metres, with outward normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.models import BodyModel
from synthgen.registration.scan import Scan, bulge

Array = NDArray[np.float64]
LEAST_POINTS, EXTENT_POINTS = 200, 10_000
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254}
INWARD = -0.15


@dataclass(frozen=True)
class Expected:
    """What a scan should show; lengths in metres.

    Attributes
    ----------
    noun, plural : str
    range_m : (float, float)
        Smallest and largest extent.
    usual_m : (float, float)
        The same for recognising units.
    link_m : float
        Points nearer than this belong to one piece.
    apart_m : float
        Middles of two pieces that are two subjects are farther apart.
    two_m : float
        Two subjects are together longer than this.
    wide_m : float
        Neighbourhood in which the surface bulges.
    points : int
        Points to draw on a coarse mesh.
    """

    noun: str
    plural: str
    range_m: tuple[float, float]
    usual_m: tuple[float, float]
    link_m: float
    apart_m: float
    two_m: float
    wide_m: float
    points: int


# With a piece of forearm: a child's fist to a long spread hand; units are known by a bare hand.
HAND = Expected("hand", "hands", (0.055, 0.40), (0.075, 0.27), 0.025, 0.08, 0.27, 0.015, 50_000)
# A toddler to a tall man with his arms up.
BODY = Expected("body", "bodies", (0.60, 2.7), (0.75, 2.4), 0.12, 0.25, 0.0, 0.08, 150_000)


def expected_of(model: BodyModel) -> Expected:
    """Return what scans for a model should show."""
    return BODY if model.hand is None else HAND


@dataclass(frozen=True)
class Finding:
    """Why a scan cannot be fitted: a reason of the fixed list and a sentence for the user."""

    reason: str
    message: str


def extent(points: Array) -> float:
    """Return the longest side of the box of the points, 1 % cut at each end, along main axes."""
    middle = points - np.median(points, axis=0)
    spread = np.median(np.linalg.norm(middle, axis=1))
    core = middle[np.linalg.norm(middle, axis=1) < 6 * spread + 1e-12]
    axes = np.linalg.eigh(core.T @ core)[1]
    low, high = np.quantile(core @ axes, [0.01, 0.99], axis=0)
    return float((high - low).max())


def units_of(points: Array, expected: Expected = HAND) -> tuple[str, ...]:
    """Return the units in which the points would have the extent of what is expected."""
    size = extent(points)
    low, high = expected.usual_m
    return tuple(u for u, m in UNITS.items() if low <= size * m <= high)


def inspect(scan: Scan, *, check_normals: bool, expected: Expected = HAND) -> Finding | None:
    """Return what is wrong with a scan, or None."""
    if len(scan.points) < LEAST_POINTS:
        return Finding(
            "no_points", f"{len(scan.points)} finite points; at least {LEAST_POINTS} are needed"
        )
    size = extent(scan.points[:EXTENT_POINTS])
    if not expected.range_m[0] <= size <= expected.range_m[1]:
        return _wrong_size(scan.points, size, expected)
    if check_normals and bulge(scan.points, scan.normals, wide_m=expected.wide_m) < INWARD:
        inward = f"normals point into the {expected.noun}"
        return Finding("flipped_normals", f"{inward}; pass -normals, or turn the mesh's faces over")
    return _pieces(scan.points, expected)


def _wrong_size(points: Array, size: float, expected: Expected) -> Finding:
    noun, (smallest, largest) = expected.noun, expected.range_m
    found = [u for u in units_of(points, expected) if u != "m"]
    if found:
        factors = " or ".join(f"{UNITS[u]:g}" for u in found)
        return Finding(
            "scale",
            f"the scan is {size:.3g} m across; in {' or '.join(found)} it would be a {noun}: "
            f"multiply the points by {factors}",
        )
    piece = _pieces(points, expected)
    if piece is not None:
        return piece
    if size > largest:
        return Finding("background", f"the scan is {size:.2f} m across; cut out the {noun}")
    hint = ""
    if expected is BODY and HAND.range_m[0] <= size <= HAND.range_m[1]:
        hint = "; for a hand's scan take a hand model, such as cc0-hand"
    return Finding(
        "scale", f"the scan is {size:.3g} m across; a {noun} has {smallest}-{largest}{hint}"
    )


def _pieces(points: Array, expected: Expected) -> Finding | None:
    """Two pieces of full size are two subjects, unless they are views of one with a gap."""
    some = points[:3000]
    tree = cKDTree(some)
    apart_m: Any = tree.query(some, k=2)[0]
    spacing = np.quantile(apart_m[:, 1], 0.9)
    link = max(expected.link_m, 4 * float(spacing))
    n, label = len(some), connected(some, link)
    count = np.bincount(label)
    large = [k for k in np.argsort(-count)[:4] if count[k] > 0.15 * n]
    sizes = [extent(some[label == k]) for k in large]
    smallest, largest = expected.range_m
    whole = [s for s in sizes if smallest < s < largest]
    apart = [np.linalg.norm(some[label == k].mean(axis=0) - some[label == large[0]].mean(axis=0))
             for k in large[1:]]  # fmt: skip
    if len(whole) >= 2 and max(apart) > expected.apart_m and extent(some) > expected.two_m:
        message = f"{len(whole)} {expected.noun}-sized pieces; fit them one at a time"
        return Finding(f"two_{expected.plural}", message)
    if sizes and max(sizes) > largest:
        noun = expected.noun
        return Finding("background", f"one piece is {max(sizes):.2f} m across; cut out the {noun}")
    return None


def connected(points: Array, link_m: float) -> NDArray[np.int64]:
    """Return the piece (N,) of points (N, 3): chains of steps up to ``link_m`` hold one together.

    Every point reached takes its neighbours out of what is left to search, so that few are searched
    in full; listing all pairs within a link costs ten times as much.
    """
    label = np.empty(len(points), np.int64)
    _flood(np.ascontiguousarray(points), link_m**2, label)
    return label


@njit(cache=True, error_model="numpy")
def _flood(points: Any, squared: float, label: Any) -> None:
    n = len(points)
    order = np.arange(n)  # those reached come first
    reached, number = 0, 0
    for k in range(n):
        if k == reached:
            reached += 1
            number += 1
        here = order[k]
        label[here] = number - 1
        for j in range(reached, n):
            there, away = order[j], 0.0
            for a in range(3):
                away += (points[there, a] - points[here, a]) ** 2
            if away <= squared:
                order[j], order[reached] = order[reached], there
                reached += 1
