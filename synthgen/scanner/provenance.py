"""Where each vertex of a scan comes from, and how wrong it is: what no real scanner can say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import to_camera
from synthgen.geometry.normals import face_cross, unit
from synthgen.scanner.range_grid import RangeGrid
from synthgen.scanner.subject import ScanScene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measured:
    """Which unit each vertex is due to.

    Attributes
    ----------
    unit : (V,) int16
        Index into the scan's units of the one that saw it most squarely; -1 where none did (a
        filled hole).
    confidence : (V,) float32
        Correlation of that unit's window there, 0..1; 0 where none saw it, and where the sample was
        bridged from its neighbours.
    sigma_m : (V,) float32
        Standard error of that unit's depth there; NaN where none saw it.
    """

    unit: NDArray[np.int16]
    confidence: NDArray[np.float32]
    sigma_m: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Truth:
    """The true surface's point nearest to each vertex, at the reference time.

    Attributes
    ----------
    solid : (V,) int16
        Index into the scene's solids.
    face : (V,) int32
        Of that solid.
    barycentric : (V, 3) float32
    error_m : (V,) float32
        Signed distance of the vertex from the true surface, positive outside.
    """

    solid: NDArray[np.int16]
    face: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    error_m: NDArray[np.float32]


def measured_by(vertices: Array, grids: Sequence[RangeGrid], reach_m: float) -> Measured:
    """Find the unit behind every vertex (V, 3); ``reach_m`` is the largest distance in depth."""
    n = len(vertices)
    best = np.zeros(n)
    owner = np.full(n, -1, np.int16)
    confidence, sigma = np.zeros(n, np.float32), np.full(n, np.nan, np.float32)
    for k, grid in enumerate(grids):
        inside, row, column, depth = _sample_of(vertices, grid)
        near = grid.depth_z_m[row, column]
        facing = np.where(
            inside & (np.abs(near - depth) < reach_m), np.nan_to_num(grid.facing[row, column]), 0
        )
        better = facing > best
        best[better], owner[better] = facing[better], k
        confidence[better] = grid.correlation[row, column][better]
        sigma[better] = grid.sigma_m[row, column][better]
    return Measured(owner, confidence, sigma)


def _sample_of(vertices: Array, grid: RangeGrid) -> tuple[Any, Any, Any, Array]:
    """Nearest sample of a grid to each vertex: inside, row, column, depth of the vertex."""
    c = grid.camera
    local = to_camera(c, vertices)
    z = np.maximum(local[:, 2], 1e-6)
    column = np.rint((c.fx * local[:, 0] / z + c.cx) / grid.step).astype(np.int64)
    row = np.rint((c.fy * local[:, 1] / z + c.cy) / grid.step).astype(np.int64)
    height, width = grid.depth_z_m.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width) & (local[:, 2] > 0)
    return inside, np.clip(row, 0, height - 1), np.clip(column, 0, width - 1), local[:, 2]


def truth_of(vertices: Array, scene: ScanScene) -> Truth:
    """Find the nearest point of the scene's solids, at time 0, to every vertex (V, 3)."""
    counts = [len(solid.vertices) for solid in scene.solids]
    surface = np.concatenate([solid.vertices for solid in scene.solids])
    shifts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    faces = np.concatenate([s.faces + k for s, k in zip(scene.solids, shifts, strict=True)])
    starts = np.cumsum([0] + [len(solid.faces) for solid in scene.solids])
    points = np.ascontiguousarray(vertices, np.float64)
    squared, index, foot = igl.point_mesh_squared_distance(points, surface, faces)[:3]
    corners = surface[faces[index]]
    inside = igl.barycentric_coordinates(
        np.ascontiguousarray(foot), *(np.ascontiguousarray(corners[:, k]) for k in range(3))
    )
    inside = np.clip(inside, 0, None)
    inside /= inside.sum(axis=1, keepdims=True)
    outward = unit(face_cross(surface, faces[index]))
    side = np.einsum("vk,vk->v", points - foot, outward)
    solid = np.searchsorted(starts, index, side="right") - 1
    return Truth(
        solid=solid.astype(np.int16),
        face=(index - starts[solid]).astype(np.int32),
        barycentric=inside.astype(np.float32),
        error_m=(np.sqrt(squared) * np.where(side < 0, -1, 1)).astype(np.float32),
    )
