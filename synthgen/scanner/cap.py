"""Meshes that end where the scan should: cut by a plane and closed, so that no inside is seen.

An open wrist whose inside a unit sees would give two coincident surfaces that face away from each
other, on which fusion breaks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.topology import boundary_edges, boundary_loops
from synthgen.scanner.segment import CropPlane

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


def cut_and_cap(
    vertices: NDArray[Any], faces: NDArray[Any], plane: CropPlane | None = None
) -> tuple[Array, Ids, Ids]:
    """Keep whole triangles on a plane's side and close every open border with a fan.

    Parameters
    ----------
    vertices : (V, 3 + n) float
        Positions, and whatever else belongs to a vertex.
    faces : (F, 3) int
    plane : CropPlane, optional
        None cuts nothing.

    Returns
    -------
    vertices : (W, 3 + n) float64
    faces : (G, 3) int64
        What is kept, in order, then the fans.
    source : (G,) int64
        Row of the given faces, -1 for the fans.

    Raises
    ------
    ShapeError
        If nothing is on the plane's side.
    """
    points, kept = np.asarray(vertices, np.float64), np.arange(len(faces))
    given = np.asarray(faces, np.int64)
    if plane is not None:
        kept = kept[plane.keeps(points[:, :3])[given].all(axis=1)]
    kept = _without_pinches(given, kept)
    if not len(kept):
        raise ShapeError(f"nothing lies on the side of {plane} that is kept; turn its normal")
    fans: list[Ids] = []
    tips: list[Array] = []
    for loop in boundary_loops(given[kept]):
        tip = len(points) + len(tips)
        tips.append(points[loop].mean(axis=0))
        fans.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), tip)], axis=1))
    whole = np.concatenate([given[kept], *fans])
    points = np.concatenate([points, np.array(tips).reshape(-1, points.shape[1])])
    used, index = np.unique(whole, return_inverse=True)
    source = np.concatenate([kept, np.full(len(whole) - len(kept), -1)])
    return points[used], index.reshape(-1, 3).astype(np.int64), source.astype(np.int64)


def _without_pinches(faces: Ids, kept: Ids) -> Ids:
    """Drop triangles until no border passes twice through a vertex."""
    while len(kept):
        starts, counts = np.unique(boundary_edges(faces[kept])[:, 0], return_counts=True)
        pinched = starts[counts > 1]
        if not len(pinched):
            break
        kept = kept[~np.isin(faces[kept], pinched).any(axis=1)]
    return kept
