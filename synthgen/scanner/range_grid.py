"""From disparities to a grid of oriented points, with what looks like an edge removed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import to_world
from synthgen.geometry.normals import unit
from synthgen.scanner.match import DisparityGrid
from synthgen.scanner.rectify import Rectified

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GridSettings:
    """What a range grid keeps; these are what keeps holes open and edges clean.

    Attributes
    ----------
    jump_px : float
        Largest distance of a disparity from the median of its 5x5 neighbours, pixels.
    erode : int
        Samples removed along the border of what was matched.
    facing : float
        Least cosine between the surface and the line of sight.
    """

    jump_px: float = 0.7
    erode: int = 1
    facing: float = 0.25


ROUGH = GridSettings(jump_px=2.0, erode=0, facing=0.1)
"""Keeps ragged edges and some webbing between fingers, as raw scans have them."""


@dataclass(frozen=True, eq=False)
class RangeGrid:
    """Oriented points of one unit, in the pair's frame; rows and columns as the disparity grid's.

    Attributes
    ----------
    pair : Rectified
    step : int
        Pixels between samples.
    depth_z_m : (h, w) float64
        NaN where nothing is known.
    normals : (h, w, 3) float64
        Unit, towards the camera; NaN with the depth.
    facing : (h, w) float64
        Cosine of normal and line of sight.
    sigma_m : (h, w) float64
        Standard error of the depth.
    correlation : (h, w) float32
    """

    pair: Rectified
    step: int
    depth_z_m: Array
    normals: Array
    facing: Array
    sigma_m: Array
    correlation: NDArray[np.float32]

    @property
    def known(self) -> NDArray[np.bool_]:
        """(h, w) where there is a point."""
        return np.isfinite(self.depth_z_m)

    def world_points(self) -> Array:
        """Return points (n, 3) where known, in the rig's frame, metres."""
        return to_world(self.pair.camera, _local(self.pair, self.step, self.depth_z_m)[self.known])

    def world_normals(self) -> Array:
        """Return unit normals (n, 3) where known, in the rig's frame."""
        return np.asarray(self.normals[self.known] @ self.pair.camera.T[:3, :3].T)


def range_grid(
    pair: Rectified, grid: DisparityGrid, settings: GridSettings | None = None
) -> RangeGrid:
    """Triangulate and filter one unit's disparities."""
    limits = settings or GridSettings()
    disparity = _without_edges(grid.disparity, limits)
    depth = pair.depth(disparity.astype(np.float64))
    points = _local(pair, grid.step, depth)
    normals = _normals(points)
    sight = unit(np.nan_to_num(-points))
    facing = np.einsum("hwk,hwk->hw", normals, sight)
    keep = np.isfinite(facing) & (facing > limits.facing)
    depth = np.where(keep, depth, np.nan)
    per_px = depth**2 / (pair.camera.fx * pair.baseline_m)
    return RangeGrid(
        pair=pair,
        step=grid.step,
        depth_z_m=depth,
        normals=np.where(keep[..., None], normals, np.nan),
        facing=np.where(keep, facing, np.nan),
        sigma_m=grid.sigma * per_px,
        correlation=grid.correlation,
    )


def _without_edges(disparity: NDArray[np.float32], limits: GridSettings) -> NDArray[np.float32]:
    known = np.isfinite(disparity)
    median = cv2.medianBlur(np.where(known, disparity, -999).astype(np.float32), 5)
    calm = known & (np.abs(np.nan_to_num(disparity) - median) <= limits.jump_px)
    if limits.erode:
        n = 2 * limits.erode + 1
        calm = cv2.erode(calm.astype(np.uint8), np.ones((n, n), np.uint8)) > 0
    return np.where(calm, disparity, np.nan).astype(np.float32)


def _local(pair: Rectified, step: int, depth: NDArray[Any]) -> Array:
    c = pair.camera
    rows, columns = np.indices(depth.shape) * step
    return np.stack([(columns - c.cx) / c.fx * depth, (rows - c.cy) / c.fy * depth, depth], axis=-1)


def _normals(points: Array) -> Array:
    """Cross products of central differences, towards the camera, slightly smoothed."""
    normals = np.full_like(points, np.nan)
    right = points[1:-1, 2:] - points[1:-1, :-2]
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    normals[1:-1, 1:-1] = unit(np.cross(down, right))
    known = np.isfinite(normals[..., 0])
    smooth = cv2.GaussianBlur(np.where(known[..., None], normals, 0), (0, 0), 0.7)
    return np.where(known[..., None], unit(np.asarray(smooth, np.float64)), np.nan)
