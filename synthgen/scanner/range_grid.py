"""From disparities to a grid of oriented points, of which those near an edge count less."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from synthgen.geometry.cameras import Camera, to_camera, to_world
from synthgen.geometry.normals import unit
from synthgen.scanner.glass import seen_position, shifted_origins, thickness_for
from synthgen.scanner.match import DisparityGrid
from synthgen.scanner.rectify import Rectified
from synthgen.scanner.rig import Glass

Array = NDArray[np.float64]
_LEAST_DIRECTIONS = 3


@dataclass(frozen=True)
class GridSettings:
    """What a range grid keeps, and how much each sample of it counts.

    Attributes
    ----------
    jump_px : float
        Largest distance of a disparity from the median of its 5x5 neighbours, pixels.
    bridge : int
        How often single missing samples between known ones are filled in; what is wider than about
        twice this many samples stays open.
    erode : int
        Samples removed along the border of what was matched.
    soft : int
        How many samples from the border a sample counts fully; nearer to it, where its window
        reaches over the edge, it counts by the square of the share. The five outermost rings of a
        hand have errors of 0.15, 0.07, 0.04, 0.03 and 0.025 mm.
    facing : float
        Least cosine between the surface and both lines of sight.
    """

    jump_px: float = 1.5
    bridge: int = 2
    erode: int = 0
    soft: int = 5
    facing: float = 0.25


@dataclass(frozen=True, eq=False)
class RangeGrid:
    """Oriented points of one unit; rows and columns as the disparity grid's.

    Attributes
    ----------
    camera : Camera
        The rectified left view, moved to where it seems to stand where it looks through glass;
        points and normals are in its frame, and nearly project to their own samples.
    baseline_m : float
        From the camera to the pair's other eye, along the camera's x axis.
    step : int
        Pixels between samples.
    points : (h, w, 3) float64
        NaN where nothing is known.
    normals : (h, w, 3) float64
        Unit, towards the camera; NaN with the points.
    facing : (h, w) float64
        Cosine between the normal and the line of sight of that eye which sees it less squarely.
    trust : (h, w) float64
        What a sample counts by its distance from the border of what was matched, 0..1.
    sigma_m : (h, w) float64
        Standard error of the depth.
    correlation : (h, w) float32
    """

    camera: Camera
    baseline_m: float
    step: int
    points: Array
    normals: Array
    facing: Array
    trust: Array
    sigma_m: Array
    correlation: NDArray[np.float32]

    @property
    def depth_z_m(self) -> Array:
        """(h, w) depth along the pair's axis."""
        return self.points[..., 2]

    @property
    def known(self) -> NDArray[np.bool_]:
        """(h, w) where there is a point."""
        return np.isfinite(self.depth_z_m)

    def world_points(self) -> Array:
        """Return points (n, 3) where known, in the rig's frame, metres."""
        return to_world(self.camera, self.points[self.known])

    def world_normals(self) -> Array:
        """Return unit normals (n, 3) where known, in the rig's frame."""
        return np.asarray(self.normals[self.known] @ self.camera.T[:3, :3].T)


def range_grid(
    pair: Rectified,
    grid: DisparityGrid,
    settings: GridSettings | None = None,
    glass: Glass | None = None,
) -> RangeGrid:
    """Triangulate and filter one unit's disparities; ``glass`` is what it may look through."""
    limits = settings or GridSettings()
    disparity = _calm(grid.disparity, limits).astype(np.float64)
    sigma = bridged(grid.sigma, limits.bridge)
    rows, columns = np.indices(disparity.shape) * np.int64(grid.step)
    world = triangulate(pair, columns, rows, disparity, glass)
    camera = _seeming(pair.camera, world, glass)
    points = to_camera(camera, world)
    normals = _normals(points)  # of all that is known: what is cut off next still tells the tilt
    ring = _rings(np.isfinite(disparity))
    facing = least_facing(points, normals, pair.baseline_m)
    keep = np.isfinite(facing) & (facing > limits.facing) & (ring > limits.erode)
    per_px = points[..., 2] ** 2 / (pair.camera.fx * pair.baseline_m)
    return RangeGrid(
        camera=camera,
        baseline_m=pair.baseline_m,
        step=grid.step,
        points=np.where(keep[..., None], points, np.nan),
        normals=np.where(keep[..., None], normals, np.nan),
        facing=np.where(keep, facing, np.nan),
        trust=np.where(keep, np.minimum(ring / max(limits.soft, 1), 1) ** 2, 0),
        sigma_m=np.where(keep, sigma * per_px, np.nan),
        correlation=grid.correlation,
    )


def least_facing(points: Array, normals: Array, baseline_m: float) -> Array:
    """Cosine (...) of normals with the line of sight of the less squarely looking eye of a pair.

    ``points`` and ``normals`` (..., 3) are in the frame of the first eye, the other is on its x
    axis. A pair measures only what both see.
    """
    at = np.nan_to_num(points)
    eyes = np.zeros(3), np.array([baseline_m, 0.0, 0.0])
    one, two = (np.einsum("...k,...k->...", normals, unit(eye - at)) for eye in eyes)
    return np.asarray(np.minimum(one, two))


def _calm(disparity: NDArray[np.float32], limits: GridSettings) -> NDArray[np.float32]:
    """Drop what its neighbours contradict and bridge small gaps."""
    known = np.isfinite(disparity)
    median = cv2.medianBlur(np.where(known, disparity, -999).astype(np.float32), 5)
    calm = known & (np.abs(np.nan_to_num(disparity) - median) <= limits.jump_px)
    return bridged(np.where(calm, disparity, np.nan).astype(np.float32), limits.bridge)


def _rings(known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the number (h, w) of each sample's ring from the border inwards, from 1; 0 unknown."""
    wide = np.pad(known, 1)
    return np.asarray(distance_transform_cdt(wide, "chessboard")[1:-1, 1:-1], np.int64)


def bridged(values: NDArray[np.float32], passes: int) -> NDArray[np.float32]:
    """Fill samples (h, w) that lie between known ones in at least three of four directions.

    Each direction gives the mean of its two ends, so that a plane is continued exactly.
    """
    found = values.copy()
    for _ in range(passes):
        wide = np.pad(found, 1, constant_values=np.nan)
        height, width = found.shape
        total, count = np.zeros_like(found), np.zeros_like(found)
        for j, i in ((0, 1), (1, 0), (1, 1), (1, -1)):
            ahead = wide[1 + j : 1 + j + height, 1 + i : 1 + i + width]
            behind = wide[1 - j : 1 - j + height, 1 - i : 1 - i + width]
            middle = (ahead + behind) / 2
            count += np.isfinite(middle)
            total += np.nan_to_num(middle)
        gap = ~np.isfinite(found) & (count >= _LEAST_DIRECTIONS)
        found[gap] = total[gap] / count[gap]
    return found


def triangulate(
    pair: Rectified, x: NDArray[Any], y: NDArray[Any], disparity: Array, glass: Glass | None = None
) -> Array:
    """World points (..., 3) of rectified left pixels with disparities, through glass if need be.

    Through glass rays keep their directions but not their origins, and miss each other a little:
    the middle between them is returned.
    """
    straight = pair.points(x, y, disparity)
    eyes = pair.left.position, pair.right.position
    if glass is None or not any(thickness_for(glass, eye) for eye in eyes):
        return straight
    known = np.isfinite(disparity)
    ways = [unit(straight[known] - eye) for eye in eyes]
    a, b = (shifted_origins(glass, eye, way) for eye, way in zip(eyes, ways, strict=True))
    u, v = ways
    cross = np.cross(u, v)
    area = np.einsum("nk,nk->n", cross, cross)
    s = np.einsum("nk,nk->n", np.cross(b - a, v), cross) / area
    t = np.einsum("nk,nk->n", np.cross(b - a, u), cross) / area
    straight[known] = (a + s[:, None] * u + b + t[:, None] * v) / 2
    return straight


def _seeming(camera: Camera, world: Array, glass: Glass | None) -> Camera:
    """Where a camera seems to stand for the middle of what it sees."""
    known = np.isfinite(world[..., 0])
    if glass is None or not known.any():
        return camera
    T = camera.T
    T[:3, 3] = seen_position(glass, camera.position, world[known].mean(axis=0)[None])[0]
    rows = tuple(tuple(float(v) for v in row) for row in T)
    return replace(camera, T_world_from_camera=rows)


def _normals(points: Array) -> Array:
    """Cross products of central differences, towards the camera, slightly smoothed."""
    normals = np.full_like(points, np.nan)
    right = points[1:-1, 2:] - points[1:-1, :-2]
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    normals[1:-1, 1:-1] = unit(np.cross(down, right))
    known = np.isfinite(normals[..., 0])
    smooth = cv2.GaussianBlur(np.where(known[..., None], normals, 0), (0, 0), 0.7)
    return np.where(known[..., None], unit(np.asarray(smooth, np.float64)), np.nan)
