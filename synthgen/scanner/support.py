"""What of a fused surface was measured: the rest, which fusion continued over edges, is cut off.

Averaging distances makes surface up to a voxel beyond the last sample, and grazing samples make
surface where a pair hardly sees any. A vertex stays where some pair measured around it, not only on
one side, and sees it squarely enough with both eyes, judged by the fused surface's own normals.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ScanError
from synthgen.geometry.cameras import to_camera
from synthgen.geometry.normals import vertex_normals
from synthgen.scanner.isosurface import Mesh, large_pieces
from synthgen.scanner.range_grid import RangeGrid, least_facing
from synthgen.scanner.tsdf import FusionSettings

Array = NDArray[np.float64]
# Of the four samples around a vertex; three span a triangle around or beside it.
_LEAST_AROUND = 3


def cut_unsupported(
    vertices: Array, faces: NDArray[np.int64], grids: Sequence[RangeGrid], settings: FusionSettings
) -> Mesh:
    """Keep the faces whose vertices (V, 3) are all supported by some unit.

    Raises
    ------
    ScanError
        If nothing is left.
    """
    keep = supported(vertices, vertex_normals(vertices, faces), grids, settings)
    left = large_pieces(faces[keep[faces].all(axis=1)], len(vertices), settings.least_faces)
    if not len(left):
        raise ScanError(
            f"the scan is empty: no unit sees a piece of {settings.least_faces} faces with both "
            f"cameras at a cosine above {settings.facing:g}; turn the subject towards the units, "
            "or use a smaller fusion.facing or fusion.least_faces"
        )
    used, index = np.unique(left, return_inverse=True)
    return vertices[used], index.reshape(-1, 3)


def supported(
    vertices: Array, normals: Array, grids: Sequence[RangeGrid], settings: FusionSettings
) -> NDArray[np.bool_]:
    """Tell which vertices (V, 3) with unit normals some unit measured, and squarely enough."""
    reach = settings.truncation * settings.voxel_m
    found = np.zeros(len(vertices), dtype=bool)
    for grid in grids:
        local = to_camera(grid.camera, vertices)
        toward = normals @ grid.camera.T[:3, :3]
        square = least_facing(local, toward, grid.baseline_m) > settings.facing
        rows = np.flatnonzero(square & ~found)
        found[rows] = _around(grid, local[rows], reach) >= _LEAST_AROUND
    return found


def _around(grid: RangeGrid, local: Array, reach_m: float) -> NDArray[Any]:
    """Count the known samples (n,) of a similar depth among the four around each point (n, 3)."""
    c = grid.camera
    z = np.maximum(local[:, 2], 1e-6)
    column = np.floor((c.fx * local[:, 0] / z + c.cx) / grid.step).astype(np.int64)
    row = np.floor((c.fy * local[:, 1] / z + c.cy) / grid.step).astype(np.int64)
    height, width = grid.depth_z_m.shape
    count = np.zeros(len(local), np.int64)
    for j, i in np.ndindex(2, 2):
        inside = (row + j >= 0) & (row + j < height) & (column + i >= 0) & (column + i < width)
        at = np.clip(row + j, 0, height - 1), np.clip(column + i, 0, width - 1)
        with np.errstate(invalid="ignore"):
            count += inside & (np.abs(grid.depth_z_m[at] - local[:, 2]) < reach_m)
    return count
