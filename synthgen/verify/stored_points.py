"""The points that a corpus gives its user for one hand: scan, sensor depth or exact depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.columns import DEPTH_STEP_M
from synthgen.corpus.sample import Sample, View
from synthgen.geometry.cameras import camera_from_K, pixel_rays
from synthgen.geometry.normals import unit

Array = NDArray[np.float64]
HAND_PARTS = 16
# Neighbouring pixels whose depths differ by more than this share of the depth are two surfaces.
JUMP, GRAZING = 0.012, 0.2


@dataclass(frozen=True, eq=False)
class StoredPoints:
    """Points of one hand, world frame.

    Attributes
    ----------
    points, normals : (N, 3) float64, metres, outward
    source : "scan", "sensor depth", "depth" or "none"
    noise_m : float
        What the stored form alone explains: the rounding of the depth.
    viewpoints : (C, 3)
    """

    points: Array
    normals: Array
    source: str
    noise_m: float
    viewpoints: Array


def stored_points(sample: Sample, number: int) -> StoredPoints:
    """Gather the points of hand ``number`` (0, 1, ...) of a sample from what is stored."""
    scan: Any = sample.scan
    eyes = np.array([view.camera.T_world_from_camera[:3, 3] for view in sample.views])
    if scan is not None:
        return StoredPoints(np.asarray(scan.vertices, np.float64),
                            np.asarray(scan.normals, np.float64), "scan", 2e-4, eyes)  # fmt: skip
    clouds = [_view_cloud(view, number) for view in sample.views]
    found = [cloud for cloud in clouds if cloud is not None]
    if not found:
        nothing = np.zeros((0, 3))
        return StoredPoints(nothing, nothing, "none", 0.0, eyes)
    points = np.concatenate([c[0] for c in found])
    normals = np.concatenate([c[1] for c in found])
    return StoredPoints(points, normals, found[0][2], DEPTH_STEP_M / np.sqrt(12), eyes)


def _view_cloud(view: View, number: int) -> tuple[Array, Array, str] | None:
    """Points and normals of a hand in one view, or None where the view has no depth."""
    try:
        sensor: Any = view.sensor_depth_z_m
        depth = np.asarray(view.depth_z_m if sensor is None else sensor, dtype=np.float64)
    except KeyError:
        return None
    mine = (view.instance_id == number + 1) & (view.part_id <= HAND_PARTS) & (view.part_id > 0)
    grid = _grid(view, depth)
    normals, sound = _normals(grid, depth, mine)
    T = view.camera.T_world_from_camera
    points = grid[sound] @ T[:3, :3].T + T[:3, 3]
    return points, normals @ T[:3, :3].T, "depth" if sensor is None else "sensor depth"


def _grid(view: View, depth: Array) -> Array:
    """Points (H, W, 3) in the camera's frame."""
    c = view.camera
    camera = camera_from_K(c.K, c.width, c.height, None, c.distortion)
    rays = pixel_rays(camera)[1]
    return np.asarray(rays / rays[..., 2:] * depth[..., None])


def _normals(grid: Array, depth: Array, mine: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return normals (N, 3) towards the camera by central differences, and where sound."""
    inner = np.zeros_like(mine)
    core = (slice(1, -1), slice(1, -1))
    right, left = (slice(1, -1), slice(2, None)), (slice(1, -1), slice(None, -2))
    below, above = (slice(2, None), slice(1, -1)), (slice(None, -2), slice(1, -1))
    smooth = mine[core] & (depth[core] > 0)
    for side in (right, left, below, above):
        smooth = smooth & mine[side] & (np.abs(depth[side] - depth[core]) < JUMP * depth[core])
    normals = np.zeros_like(grid)
    normals[core] = unit(np.cross(grid[below] - grid[above], grid[right] - grid[left]))
    facing = -np.sum(normals * unit(grid), axis=-1)
    inner[core] = smooth
    inner &= facing > GRAZING
    return normals[inner], inner
