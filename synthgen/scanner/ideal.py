"""What a perfect matcher would find: the true surface through the true cameras, read as nominal.

The difference of a measured disparity from it is the matcher's error alone; calibration and motion
are in both. Level ``model`` starts from it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, project
from synthgen.scanner.glass import seen_position
from synthgen.scanner.rectify import Rectified, rectified_pixels, remap_tables
from synthgen.scanner.rig import Glass, Unit
from synthgen.scanner.stage import Stage
from synthgen.scanner.truth import see, seen_from

Array = NDArray[np.float64]


def ideal_disparity(
    stage: Stage, unit: Unit, pair: Rectified, step: int, *, time_s: float
) -> NDArray[np.float32]:
    """Return the true disparities (h, w) on a grid of the rectified left view, pixels.

    NaN where the surface is not seen by both cameras. ``stage`` is the uploaded scene and
    ``time_s`` the middle of the unit's exposure.
    """
    x, y = (table[::step, ::step] for table in remap_tables(pair, 0))
    raw = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
    sight = see(stage, unit.true.left, raw, time_s=time_s)
    found = np.full(len(raw), np.nan)
    hit = np.flatnonzero(sight.solid >= 0)
    points = sight.point_m[hit]
    right = unit.true.right
    seen = seen_from(stage, right, points, time_s=time_s)
    hit, points = hit[seen], points[seen]
    at = rectified_pixels(pair, 1, project_through(stage.rig.glass, right, points))
    columns = np.tile(np.arange(x.shape[1]) * step, x.shape[0])
    found[hit] = columns[hit] - at[:, 0]
    return found.reshape(x.shape).astype(np.float32)


def project_through(glass: Glass | None, camera: Camera, points: Array) -> Array:
    """Return the raw pixels (n, 2) of points that a camera may see through glass."""
    if glass is None or not len(points):
        return project(camera, points)[0]
    eyes = seen_position(glass, camera.position, points)
    return project(camera, points - eyes + camera.position)[0]
