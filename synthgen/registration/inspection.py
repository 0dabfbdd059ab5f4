"""Looking at a scan before fitting: it must be one hand, in metres, with outward normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from synthgen.registration.scan import Scan, bulge

Array = NDArray[np.float64]
LEAST_POINTS = 200
# Largest extent of a hand with a piece of forearm, metres: a child's fist to a long spread hand.
SMALLEST_M, LARGEST_M = 0.055, 0.40
# A bare hand; used to recognise units.
USUAL_M = (0.075, 0.27)
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254}
LINK_M, TWO_HANDS_M = 0.025, 0.27
INWARD = -0.15


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


def units_of(points: Array) -> tuple[str, ...]:
    """Return the units in which the points would have the extent of a bare hand."""
    size = extent(points)
    return tuple(u for u, m in UNITS.items() if USUAL_M[0] <= size * m <= USUAL_M[1])


def inspect(scan: Scan, *, check_normals: bool) -> Finding | None:
    """Return what is wrong with a scan, or None."""
    if len(scan.points) < LEAST_POINTS:
        return Finding(
            "no_points", f"{len(scan.points)} finite points; at least {LEAST_POINTS} are needed"
        )
    size = extent(scan.points)
    if not SMALLEST_M <= size <= LARGEST_M:
        return _wrong_size(scan.points, size)
    if check_normals and bulge(scan.points, scan.normals) < INWARD:
        return Finding("flipped_normals", "normals point into the hand; pass -normals")
    return _pieces(scan.points)


def _wrong_size(points: Array, size: float) -> Finding:
    found = [u for u in units_of(points) if u != "m"]
    if found:
        factor = UNITS[found[0]]
        return Finding(
            "scale",
            f"the scan is {size:.3g} m across; in {' or '.join(found)} it would be a hand: "
            f"multiply the points by {factor:g}",
        )
    piece = _pieces(points)
    if piece is not None:
        return piece
    if size > LARGEST_M:
        return Finding("background", f"the scan is {size:.2f} m across; cut out the hand")
    return Finding("scale", f"the scan is {size:.3g} m across; a hand has {SMALLEST_M}-{LARGEST_M}")


def _pieces(points: Array) -> Finding | None:
    """Two hand-sized pieces are two hands, unless they are views of one with a gap."""
    some = points[:3000]
    tree = cKDTree(some)
    apart_m: Any = tree.query(some, k=2)[0]
    spacing = np.quantile(apart_m[:, 1], 0.9)
    link = max(LINK_M, 4 * float(spacing))
    pairs = tree.query_pairs(link, output_type="ndarray")
    n = len(some)
    graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), (n, n))
    label = csgraph.connected_components(graph, directed=False)[1]
    count = np.bincount(label)
    large = [k for k in np.argsort(-count)[:4] if count[k] > 0.15 * n]
    sizes = [extent(some[label == k]) for k in large]
    hands = [s for s in sizes if SMALLEST_M < s < LARGEST_M]
    apart = [np.linalg.norm(some[label == k].mean(axis=0) - some[label == large[0]].mean(axis=0))
             for k in large[1:]]  # fmt: skip
    if len(hands) >= 2 and max(apart) > 0.08 and extent(some) > TWO_HANDS_M:
        return Finding("two_hands", f"{len(hands)} hand-sized pieces; fit them one at a time")
    if sizes and max(sizes) > LARGEST_M:
        return Finding("background", f"one piece is {max(sizes):.2f} m across; cut out the hand")
    return None
