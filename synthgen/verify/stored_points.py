"""The points that a corpus gives its user for one hand: scan, sensor depth or exact depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.columns import DEPTH_STEP_M
from synthgen.corpus.sample import Sample, View
from synthgen.geometry.cameras import camera_from_K, pixel_rays
from synthgen.geometry.normals import unit

if TYPE_CHECKING:
    from synthgen.scanner import Scan

Array = NDArray[np.float64]
HAND_PARTS = 16
# Neighbouring pixels whose depths differ by more than this share of the depth are two surfaces.
JUMP, GRAZING = 0.012, 0.2
# Errors that neighbours share do not average out: a sensor's are taken as means over such cells.
CELL_M = 0.01
TRUSTED_M = 1e-3


@dataclass(frozen=True, eq=False)
class StoredPoints:
    """Points of one hand, world frame.

    Attributes
    ----------
    points, normals : (N, 3) float64, metres, outward
    source : "scan", "sensor depth", "depth" or "none"
    noise_m : float
        What the stored form alone explains: the rounding of the depth.
    bias_m : float
        RMS of the errors of sensor or scanner that neighbours share, by the stored truth.
    viewpoints : (C, 3) or None
        Where the sensors stood, where that is stored.
    exact : (N, 3)
        The points without the sensor's error, where the exact depth is stored beside: they must
        lie on the true surface, however poor the sensor.
    trusted : (N,) bool
        Those of ``exact`` that must: a scan's points have no exact ones beside, so not the ones
        that lie off by the scanner's own error, as it is stored.
    """

    points: Array
    normals: Array
    source: str
    noise_m: float
    bias_m: float
    viewpoints: Array | None
    exact: Array
    trusted: NDArray[np.bool_]


def stored_points(sample: Sample, number: int) -> StoredPoints:
    """Gather the points of hand ``number`` (0, 1, ...) of a sample from what is stored."""
    if sample.scan is not None:
        return _scan_points(sample.scan)
    eyes = np.array([view.camera.T_world_from_camera[:3, 3] for view in sample.views])
    clouds = [cloud for view in sample.views if (cloud := _view_cloud(view, number)) is not None]
    if not clouds:
        nothing = np.zeros((0, 3))
        return StoredPoints(nothing, nothing, "none", 0.0, 0.0, eyes, nothing, np.zeros(0, bool))
    points, normals, exact = (np.concatenate([c[k] for c in clouds]) for k in range(3))
    bias = shared_error(points, np.sum((points - exact) * normals, axis=1))
    source = "sensor depth" if "sensor_depth" in sample.views[0].meta else "depth"
    noise, trusted = DEPTH_STEP_M / np.sqrt(12), np.ones(len(points), bool)
    return StoredPoints(points, normals, source, noise, bias, eyes, exact, trusted)


def _scan_points(scan: Scan) -> StoredPoints:
    """Take a scan as its user gets it; its cameras are known where its pictures are stored."""
    points, normals = scan.vertices.astype(np.float64), scan.normals.astype(np.float64)
    error = scan.provenance.get("error_m", np.zeros(len(points)))
    known = np.isfinite(error)
    bias = shared_error(points[known], error[known])
    eyes = [side.position for unit in scan.units for side in (unit.pair.left, unit.pair.right)]
    viewpoints = np.array(eyes) if eyes else None
    trusted = ~(np.abs(error) > TRUSTED_M)
    return StoredPoints(points, normals, "scan", 0.0, bias, viewpoints, points, trusted)


def shared_error(points: Array, error: NDArray[Any]) -> float:
    """Root mean square of the mean errors (N,) in cells of 1 cm of the points (N, 3)."""
    if len(points) == 0:
        return 0.0
    cells = np.floor(points / CELL_M).astype(np.int64)
    cell = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(cell)
    mean = np.bincount(cell, np.asarray(error, np.float64)) / count
    return float(np.sqrt(np.average(mean**2, weights=count)))


def _view_cloud(view: View, number: int) -> tuple[Array, Array, Array] | None:
    """Points, normals and exact points of a hand in one view, or None where it has no depth."""
    if not {"depth", "labels"} <= view.columns:
        return None
    sensor: Any = view.sensor_depth_z_m
    depth = np.asarray(view.depth_z_m if sensor is None else sensor, dtype=np.float64)
    mine = (view.instance_id == number + 1) & (view.part_id <= HAND_PARTS) & (view.part_id > 0)
    grid = _grid(view, depth)
    normals, sound = _normals(grid, depth, mine)
    T = view.camera.T_world_from_camera
    points, exact = (
        found[sound] @ T[:3, :3].T + T[:3, 3] for found in (grid, _grid(view, view.depth_z_m))
    )
    return points, normals @ T[:3, :3].T, exact


def _grid(view: View, depth: NDArray[Any]) -> Array:
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
