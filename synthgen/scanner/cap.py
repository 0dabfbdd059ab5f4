"""Meshes that end where the scan should: cut by a plane and closed, so that no inside is seen.

An open wrist whose inside a unit sees would give two coincident surfaces that face away from each
other, on which fusion breaks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.topology import boundary_edges, boundary_loops, pieces
from synthgen.scanner.segment import CropPlane

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
# Vertices this close to the plane lie on it; nearer cuts would leave slivers.
_ON_PLANE_M = 1e-6
# What is left of a triangle by the number of its corners on the kept side, counted from the corner
# that differs from the others: each corner of a child cuts an edge (i, j), or is corner i itself.
_CHILDREN = {
    1: np.array([[[0, 0], [0, 1], [0, 2]]]),
    2: np.array([[[0, 1], [1, 1], [2, 2]], [[0, 1], [2, 2], [0, 2]]]),
}


@dataclass(frozen=True, eq=False)
class Cut:
    """A closed mesh, and where its triangles come from.

    Attributes
    ----------
    vertices : (W, 3 + n) float64
        Positions, and whatever else belongs to a vertex.
    faces : (G, 3) int64
        What is kept, then the fans, which share no vertices with it: the rim is a sharp edge.
    source : (G,) int64
        Row of the given faces, -1 for the fans.
    corners : (G, 3, 3) float64
        Barycentrics of each triangle's corners in its source; the identity for the fans.
    """

    vertices: Array
    faces: Ids
    source: Ids
    corners: Array


def cut_and_cap(vertices: NDArray[Any], faces: NDArray[Any], plane: CropPlane | None = None) -> Cut:
    """Cut a mesh along a plane, keep its largest piece and close every open border with a fan.

    A smaller piece is, for example, an upper arm that is bent back across the wrist's plane.

    Parameters
    ----------
    vertices : (V, 3 + n) float
        What is not a position is interpolated along cut edges.
    faces : (F, 3) int
    plane : CropPlane, optional
        None cuts nothing.

    Raises
    ------
    ShapeError
        If nothing is on the plane's side.
    """
    points, given = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    source = np.arange(len(given))
    corners = np.broadcast_to(np.eye(3), (len(given), 3, 3))
    if plane is not None:
        points, given, source, corners = _clipped(points, given, plane.side(points[:, :3]))
    if len(given):
        piece = pieces(given, len(points))[given[:, 0]]
        keep = np.flatnonzero(piece == np.bincount(piece).argmax())
        keep = _without_pinches(given, keep)
        given, source, corners = given[keep], source[keep], corners[keep]
    if not len(given):
        raise ShapeError(f"nothing lies on the side of {plane} that is kept; turn its normal")
    rims = boundary_loops(given)
    lids = [np.concatenate([points[rim], points[rim].mean(axis=0)[None]]) for rim in rims]
    first = len(points) + np.cumsum([0] + [len(lid) for lid in lids])
    fans = [_fan(len(rim)) + start for rim, start in zip(rims, first, strict=False)]
    whole = np.concatenate([given, *fans])
    used, index = np.unique(whole, return_inverse=True)
    lid_faces = len(whole) - len(given)
    return Cut(
        vertices=np.concatenate([points, *lids])[used],
        faces=index.reshape(-1, 3).astype(np.int64),
        source=np.concatenate([source, np.full(lid_faces, -1)]).astype(np.int64),
        corners=np.concatenate([corners, np.broadcast_to(np.eye(3), (lid_faces, 3, 3))]),
    )


def _fan(n: int) -> Ids:
    """Triangles (n, 3) between a rim's vertices 0..n-1, run backwards, and their middle, n."""
    ring = np.arange(n)
    return np.stack([np.roll(ring, -1), ring, np.full(n, n)], axis=1)


def _clipped(points: Array, faces: Ids, side: Array) -> tuple[Array, Ids, Ids, Array]:
    """Clip triangles at ``side`` (V,) = 0: points, faces, sources and corners' barycentrics."""
    side = np.where(np.abs(side) < _ON_PLANE_M, 0.0, side)
    ahead, below = (side > 0)[faces], (side < 0)[faces].any(axis=1)
    inner = np.flatnonzero(ahead.any(axis=1) & ~below)
    rows, ends = [], []
    for count, pattern in _CHILDREN.items():
        own = np.flatnonzero(below & (ahead.sum(axis=1) == count))
        odd = (ahead[own] if count == 1 else ~ahead[own]).argmax(axis=1)
        rows.append(np.repeat(own, len(pattern)))
        ends.append((pattern + odd[:, None, None, None]).reshape(-1, 3, 2) % 3)
    row, end = np.concatenate(rows), np.concatenate(ends)
    edge = faces[row[:, None, None], end]
    a, b = side[edge[..., 0]], side[edge[..., 1]]
    share = np.where(edge[..., 0] == edge[..., 1], 0, a / np.where(a == b, 1, a - b))[..., None]
    corners = (1 - share) * np.eye(3)[end[..., 0]] + share * np.eye(3)[end[..., 1]]
    # A cut edge belongs to two triangles: one new vertex for both, from the lower end's view.
    keys, first, vertex = np.unique(
        np.sort(edge, axis=-1).reshape(-1, 2), axis=0, return_index=True, return_inverse=True
    )
    place = np.einsum("nk,nkj->nj", corners.reshape(-1, 3)[first], points[faces[row[first // 3]]])
    old = (keys[:, 0] == keys[:, 1]) | (side[keys] == 0).any(axis=1)
    there = np.where(side[keys[:, 1]] == 0, keys[:, 1], keys[:, 0])
    label = np.where(old, there, len(points) + np.cumsum(~old) - 1)
    return (
        np.concatenate([points, place[~old]]),
        np.concatenate([faces[inner], label[vertex].reshape(-1, 3)]),
        np.concatenate([inner, row]),
        np.concatenate([np.broadcast_to(np.eye(3), (len(inner), 3, 3)), corners]),
    )


def _without_pinches(faces: Ids, kept: Ids) -> Ids:
    """Drop triangles until no border passes twice through a vertex."""
    while len(kept):
        starts, counts = np.unique(boundary_edges(faces[kept])[:, 0], return_counts=True)
        pinched = starts[counts > 1]
        if not len(pinched):
            break
        kept = kept[~np.isin(faces[kept], pinched).any(axis=1)]
    return kept
