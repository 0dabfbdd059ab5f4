"""The zero surface of a field as triangles, with real holes, and a hole-filled variant."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage import measure

from synthgen.errors import ScanError
from synthgen.geometry.topology import pieces
from synthgen.scanner.tsdf import BRICK, Field

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
SLAB_VOXELS = 4_000_000
# Voxels; two slabs compute the vertices of the plane between them from equal values.
_SAME = 1e-4
_NO_SEAM = np.zeros((0, 3))


def extract(field: Field, least_faces: int, fill: float = 0.0, slab: int = SLAB_VOXELS) -> Mesh:
    """Marching cubes, slab by slab: memory follows the surface, not the box around it.

    Parameters
    ----------
    field : Field
    least_faces : int
        Smaller connected pieces are dropped.
    fill : float
        0 keeps real holes: faces only in cubes whose eight corners were observed. Above, unknown
        voxels take the distance of the nearest observed one within ``fill`` voxels, which closes
        holes up to about twice that.
    slab : int
        About how many voxels are laid out at once; the mesh does not depend on it.

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
    whole = _spread(field, fill, slab) if fill else field
    parts: list[Mesh] = []
    total, seam = 0, (_NO_SEAM, np.zeros(0, np.int64))
    for first, stop in _slabs(whole, slab):
        own, faces = _cubes(whole, first, stop)
        known, ids = seam
        label = np.arange(total, total + len(own))
        below = np.flatnonzero(own[:, 0] == first * BRICK)
        if len(known) and len(below):
            away, nearest = cKDTree(known).query(own[below])
            label[below] = np.where(away < _SAME, ids[nearest], label[below])
        parts.append((own, label[faces]))
        total += len(own)
        above = own[:, 0] == stop * BRICK
        seam = own[above], label[above]
    vertices, faces = (np.concatenate(part) for part in zip(*parts, strict=True))
    if not len(faces):
        raise ScanError("the scan is empty: the units' points do not form a surface")
    faces = large_pieces(faces, len(vertices), least_faces)
    if not len(faces):
        raise ScanError(
            f"the scan is empty: no piece of surface has {least_faces} faces; use a smaller voxel "
            "or a smaller fusion.least_faces"
        )
    used, index = np.unique(faces, return_inverse=True)
    return vertices[used] * field.voxel_m + field.origin_m, index.reshape(-1, 3)


def _slabs(field: Field, voxels: int) -> Iterator[tuple[int, int]]:
    """First and last layer of bricks, exclusive, of each slab."""
    nx, ny, nz = field.shape
    thick = max(1, voxels // max(BRICK * ny * nz, 1))
    for first in range(0, max(nx // BRICK, 1), thick):
        yield first, min(first + thick, nx // BRICK)


def _cubes(field: Field, first: int, stop: int) -> Mesh:
    """Surface within some layers, with the first voxels of the next: vertices in voxels, faces."""
    distance = field.slab(first, stop + 1)[: (stop - first) * BRICK + 1]
    known = np.isfinite(distance)
    filled = np.where(known, distance, np.float32(field.voxel_m))
    if not known.any() or not filled.min() < 0 < filled.max():
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    for axis in range(3):  # a cube is whole when both of its faces are
        known = np.logical_and(*(_cut(known, axis, side) for side in (0, 1)))
    cubes: Any = measure.marching_cubes
    vertices, faces, _, _ = cubes(filled, 0.0, allow_degenerate=False)
    middle = np.floor(vertices[faces].mean(axis=1)).astype(np.int64)
    # Where a distance is exactly 0, a face can lie in the last plane of voxels.
    i, j, k = np.minimum(middle, np.array(known.shape) - 1).T
    used, index = np.unique(faces[known[i, j, k]], return_inverse=True)
    return vertices[used] + np.array([first * BRICK, 0.0, 0.0]), index.reshape(-1, 3)


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


def _spread(field: Field, voxels: float, slab: int) -> Field:
    """Let unknown voxels take the distance of the nearest known one."""
    margin = int(np.ceil(voxels / BRICK))
    bricks, values = [], []
    for first, stop in _slabs(field, slab):
        distance = field.slab(first - margin, stop + margin)
        away, nearest = ndimage.distance_transform_edt(~np.isfinite(distance), return_indices=True)
        near = np.where(away <= voxels, distance[tuple(nearest)], np.nan)
        inner = near[margin * BRICK : len(near) - margin * BRICK].astype(np.float32)
        layers, rows, columns = (n // BRICK for n in inner.shape)
        cut = inner.reshape(layers, BRICK, rows, BRICK, columns, BRICK).transpose(0, 2, 4, 1, 3, 5)
        kept = np.isfinite(cut).any(axis=(3, 4, 5))
        bricks.append(np.argwhere(kept) + [first, 0, 0])
        values.append(cut[kept])
    return replace(field, bricks=np.concatenate(bricks), distance_m=np.concatenate(values))
