"""Which vertices of a placed mesh the sensors could see, by the z-buffer (no renderer)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.cameras import camera_from_K, project
from synthgen.geometry.normals import unit
from synthgen.geometry.raster import rasterise
from synthgen.geometry.transforms import look_at
from synthgen.registration.surface import Placed

Array = NDArray[np.float64]
PIXELS, BEHIND_M, GRAZING = 96, 0.004, 0.2


def visible_vertices(placed: Placed, viewpoints: Array) -> NDArray[np.bool_]:
    """Return (V,) whether any viewpoint (C, 3), metres, sees a vertex, not grazing.

    A viewpoint inside the hand's own extent sees everything: nothing can be said from there.
    """
    seen = np.zeros(len(placed.vertices), dtype=bool)
    for eye in viewpoints:
        seen |= _seen_from(placed, eye)
    return seen


def _seen_from(placed: Placed, eye: Array) -> NDArray[np.bool_]:
    vertices = placed.vertices
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    distance = float(np.linalg.norm(eye - centre))
    if distance < 1.2 * radius:
        return np.ones(len(vertices), dtype=bool)
    focal = 0.48 * PIXELS * np.sqrt(distance**2 - radius**2) / radius
    middle = PIXELS / 2 - 0.5
    K = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    try:
        T = look_at(eye, centre)
    except ShapeError:
        T = look_at(eye, centre, (1.0, 0.0, 0.0))
    camera = camera_from_K(K, PIXELS, PIXELS, T)
    depth = rasterise(vertices, placed.surface.faces, camera)[2]
    pixels, z = project(camera, vertices)
    column, row = np.clip(np.rint(pixels).astype(int), 0, PIXELS - 1).T
    surface = depth[row, column]
    front = (surface == 0) | (z < surface + BEHIND_M)
    facing = np.sum(placed.normals * unit(eye - vertices), axis=1) > GRAZING
    return np.asarray(front & facing)
