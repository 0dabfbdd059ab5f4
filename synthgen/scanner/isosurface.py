"""The zero surface of a field as triangles, with real holes, and a hole-filled variant."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage import measure

from synthgen.errors import ScanError
from synthgen.geometry.topology import pieces
from synthgen.scanner.tsdf import Field

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]


def extract(field: Field, least_faces: int, fill: float = 0.0) -> Mesh:
    """Marching cubes.

    Parameters
    ----------
    field : Field
    least_faces : int
        Smaller connected pieces are dropped.
    fill : float
        0 keeps real holes: faces only in cubes whose eight corners were observed. Above, unknown
        voxels take the distance of the nearest observed one within ``fill`` voxels, which closes
        holes up to about twice that.

    Returns
    -------
    vertices : (V, 3) float64, rig frame, metres
    faces : (F, 3) int64
        Counter-clockwise seen from outside.

    Raises
    ------
    ScanError
        If nothing is left.
    """
    distance = _spread(field.distance_m, fill) if fill else field.distance_m
    known = np.isfinite(distance)
    outside = np.float32(field.voxel_m)
    filled = np.where(known, distance, outside)
    if known.sum() < 8 or not (filled.min() < 0 < filled.max()):
        raise ScanError("the scan is empty: the units' points do not form a surface")
    whole = known.copy()
    for axis in range(3):  # a cube is whole when both of its faces are
        whole = np.logical_and(*(_cut(whole, axis, side) for side in (0, 1)))
    cubes: Any = measure.marching_cubes
    vertices, faces, _, _ = cubes(filled, 0.0, allow_degenerate=False)
    cube = np.floor(vertices[faces].mean(axis=1)).astype(np.int64)
    faces = faces[whole[cube[:, 0], cube[:, 1], cube[:, 2]]].astype(np.int64)
    faces = large_pieces(faces, len(vertices), least_faces)
    if not len(faces):
        raise ScanError(
            f"the scan is empty: no piece of surface has {least_faces} faces; use a smaller voxel "
            "or a smaller fusion.least_faces"
        )
    used, index = np.unique(faces, return_inverse=True)
    placed = vertices[used].astype(np.float64) * field.voxel_m + field.origin_m
    return placed, index.reshape(-1, 3)


def _cut(values: NDArray[np.bool_], axis: int, side: int) -> NDArray[np.bool_]:
    cut = [slice(None)] * 3
    cut[axis] = slice(1, None) if side else slice(None, -1)
    return np.asarray(values[tuple(cut)])


def large_pieces(faces: NDArray[np.int64], n: int, least: int) -> NDArray[np.int64]:
    """Return the faces, over n vertices, of connected pieces that have at least ``least``."""
    if not len(faces):
        return faces
    piece = pieces(faces, n)[faces[:, 0]]
    return np.asarray(faces[np.bincount(piece)[piece] >= least])


def _spread(distance: NDArray[np.float32], voxels: float) -> NDArray[np.float32]:
    unknown = ~np.isfinite(distance)
    away, nearest = ndimage.distance_transform_edt(unknown, return_indices=True)
    return np.where(away <= voxels, distance[tuple(nearest)], np.nan).astype(np.float32)
