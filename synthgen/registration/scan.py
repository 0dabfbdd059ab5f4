"""A scan as the fitter sees it: shuffled points, outward normals, one search tree."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from synthgen.errors import ShapeError
from synthgen.geometry.normals import unit
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
# Numbers beyond this are no positions: squares of theirs overflow in the end.
FARTHEST_M = 1e12
# Mesh-to-scan needs density, not every point.
TREE_POINTS = 15_000
NEIGHBOURS, WIDE_M = 12, 0.015
# Of the scatter of points: width of a neighbourhood over the scatter in it, its most points, and
# how far skin is flat.
WIDE_NOISE, MOST_NEIGHBOURS, FLAT_M = 5.0, 400, 5e-3


@dataclass(frozen=True, eq=False)
class Scan:
    """Points in random order, so that every prefix is a fair subsample.

    Attributes
    ----------
    points : (N, 3) float64, metres
    normals : (N, 3) float64, unit, outward
    viewpoints : (C, 3) or None
        Where the sensors stood, metres.
    tree_points : int
        Points in the search tree.
    """

    points: Array
    normals: Array
    viewpoints: Array | None = None
    tree_points: int = TREE_POINTS

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree over the first ``tree_points`` points, made once."""
        return cKDTree(self.points[: self.tree_points])

    @cached_property
    def centre(self) -> Array:
        """Mean (3,) of the points within 2.2 times the median distance of the median."""
        middle = np.median(self.points, axis=0)
        distance = np.linalg.norm(self.points - middle, axis=1)
        near = distance <= 2.2 * np.median(distance) + 1e-12
        return np.asarray(self.points[near].mean(axis=0))

    @cached_property
    def local_noise_m(self) -> float:
        """Median scatter of points about the planes of their nearest neighbours, metres.

        A dozen neighbours, and as many as it takes to make the neighbourhood five times as wide as
        the scatter: in a narrower one those are near whose noise is alike, and 1 mm looks like 0.6.
        Not beyond 5 mm, where skin bends.
        """
        most = min(self.tree.n, MOST_NEIGHBOURS)
        k = min(NEIGHBOURS, most)
        while True:
            scatter, reach = self._scatter_m(k)
            wanted = WIDE_NOISE * scatter / max(reach, 1e-12)
            if wanted <= 1 or k == most or reach > FLAT_M:
                return scatter
            k = min(int(np.ceil(k * max(wanted**2, 1.3))), most)

    def _scatter_m(self, k: int) -> tuple[float, float]:
        """Return the scatter of k neighbours about their plane, and how far they reach."""
        found: Any = self.tree.query(self.points[:400], k=k)
        near = self.points[np.asarray(found[1])]
        local = near - near.mean(axis=1, keepdims=True)
        least = np.linalg.eigvalsh(np.einsum("nka,nkb->nab", local, local))[:, 0]
        scatter = np.sqrt(np.median(np.maximum(least, 0)) / max(k - 3, 1))
        return float(scatter), float(np.median(found[0][:, -1]))

    def mirrored(self) -> Scan:
        """Reflect x: a left hand's scan becomes a right hand's."""
        flip = np.array([-1.0, 1.0, 1.0])
        eyes = None if self.viewpoints is None else self.viewpoints * flip
        return Scan(self.points * flip, self.normals * flip, eyes)

    def flipped(self) -> Scan:
        """Return the same scan with reversed normals."""
        return replace(self, normals=-self.normals)


def nearest(
    tree: cKDTree, points: Array, within_m: float = np.inf
) -> tuple[Array, NDArray[np.int64]]:
    """Return distance (inf where none is within) and number of the nearest point of each."""
    found: Any = tree.query(points, distance_upper_bound=within_m)
    return np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)


def checked_points(points: Any, normals: Any) -> tuple[Array, Array | None, int]:
    """Return finite points, their normals, and how many points were dropped.

    Points that are not finite, or beyond 1e12 m, and points whose normal is not finite or zero,
    are dropped.

    Raises
    ------
    ShapeError
        If arrays are not (N, 3) or do not belong together.
    """
    p = np.asarray(points, dtype=np.float64)
    if p.size == 0:
        return np.zeros((0, 3)), None, 0
    if p.ndim != 2 or p.shape[1] != 3:
        raise ShapeError(f"points have shape {p.shape}; expected (N, 3), metres")
    good = are_positions(p)
    if normals is None:
        return p[good], None, int((~good).sum())
    n = np.asarray(normals, dtype=np.float64)
    if n.shape != p.shape:
        raise ShapeError(f"normals have shape {n.shape}, points {p.shape}; pass one a point")
    good &= np.isfinite(n).all(axis=1)
    length = np.linalg.norm(np.where(good[:, None], n, 0.0), axis=1)
    good &= length > 1e-9
    return p[good], n[good] / length[good, None], int((~good).sum())


def are_positions(points: Array) -> NDArray[np.bool_]:
    """Return (N,) whether a point's coordinates are finite and within 1e12 m."""
    return np.asarray((np.abs(points) < FARTHEST_M).all(axis=1))


def scan_of(
    points: Array,
    normals: Array | None,
    viewpoints: Any = None,
    *,
    seed: int = 0,
    wide_m: float = WIDE_M,
    tree_points: int = TREE_POINTS,
) -> Scan:
    """Shuffle points and complete normals; see :func:`estimate_normals`.

    Raises
    ------
    ShapeError
        If viewpoints are no finite (C, 3).
    """
    order = stream(seed, "corpus", 0, 0, "scan order").permutation(len(points))
    eyes = None if viewpoints is None else _checked_viewpoints(viewpoints)
    p = points[order]
    n = estimate_normals(p, eyes, wide_m) if normals is None else normals[order]
    return Scan(p, n, eyes, tree_points)


def _checked_viewpoints(viewpoints: Any) -> Array:
    eyes = np.atleast_2d(np.asarray(viewpoints, dtype=np.float64))
    if eyes.ndim != 2 or eyes.shape[1] != 3 or len(eyes) == 0:
        raise ShapeError(f"viewpoints have shape {eyes.shape}; expected (C, 3), metres, or None")
    if not np.isfinite(eyes).all():
        raise ShapeError("viewpoints hold a number that is not finite; leave that sensor out")
    return eyes


def estimate_normals(
    points: Array, viewpoints: Array | None = None, wide_m: float = WIDE_M
) -> Array:
    """Estimate normals (N, 3) from the planes of neighbouring points.

    Signs: towards the nearest sensor where viewpoints (C, 3) are known; else consistent along a
    spanning tree of neighbours (Hoppe 1992) and outward as a whole, since hands and bodies bulge
    within ``wide_m``.
    """
    k = min(NEIGHBOURS, len(points))
    found: Any = cKDTree(points).query(points, k=k)
    near = np.asarray(found[1], dtype=np.int64)
    local = points[near] - points[near].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nka,nkb->nab", local, local))[1][:, :, 0]
    if viewpoints is not None:
        eye = viewpoints[nearest(cKDTree(viewpoints), points)[1]]
        return normals * np.where(np.sum(normals * (eye - points), axis=1) < 0, -1, 1)[:, None]
    normals = _consistent(normals, near)
    return normals if bulge(points, normals, wide_m=wide_m) >= 0 else -normals


def _consistent(normals: Array, near: NDArray[np.int64]) -> Array:
    """Flip normals along a minimum spanning tree of 1 - |cos| over the neighbours."""
    n, k = near.shape
    rows, columns = np.repeat(np.arange(n), k - 1), near[:, 1:].ravel()
    cosine = np.sum(normals[rows] * normals[columns], axis=1)
    graph = sparse.csr_matrix((1.0 + 1e-6 - np.abs(cosine), (rows, columns)), (n, n))
    tree = csgraph.minimum_spanning_tree(graph.maximum(graph.T))
    both = tree + tree.T
    signs = np.ones(n)
    seen = np.zeros(n, dtype=bool)
    for start in range(n):
        if seen[start]:
            continue
        order, parent = csgraph.breadth_first_order(both, start, directed=False)
        seen[order] = True
        for child in order[1:]:
            up = parent[child]
            agree = np.dot(normals[child], normals[up]) >= 0
            signs[child] = signs[up] if agree else -signs[up]
    return normals * signs[:, None]


def bulge(points: Array, normals: Array, most: int = 250, wide_m: float = WIDE_M) -> float:
    """Return how much normals point out of the bulging shape, -1 .. 1; hands have about 0.5.

    Mean cosine between a point's normal and its offset from the mean of the points within
    ``wide_m``.
    """
    some = points[:most]
    offsets = np.array(
        [p - points[ids].mean(axis=0)
         for p, ids in zip(some, cKDTree(points[:4000]).query_ball_point(some, wide_m), strict=True)
         ]
    )  # fmt: skip
    return float(np.mean(np.sum(unit(offsets) * normals[:most], axis=1)))
