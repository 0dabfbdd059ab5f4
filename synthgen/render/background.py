"""Where walls and floor are: quads of fixed count, whatever the background."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera
from synthgen.sampling.lighting import room_box
from synthgen.scene import Background

Array = NDArray[np.float64]

WALLS = 5
# Corner order of a quad seen from its front: lower left, lower right, upper right, upper left.
_QUAD_UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
_WALL_HALF_M = 6.0
_WALL_REPEAT_M, _FLOOR_REPEAT_M = 0.8, 1.2
_GROUND_HALF_M = 60.0
_NOWHERE_M = np.array([0.0, -60.0, 0.0])


def quads(count: int) -> NDArray[np.int64]:
    """Triangles (2 count, 3) of quads of four vertices each."""
    base = 4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return np.asarray(base.reshape(-1, 3), dtype=np.int64)


def wall_geometry(background: Background, camera: Camera) -> tuple[Array, Array]:
    """Corners (20, 3) of five quads, world, metres, and their texture coordinates (20, 2).

    A room uses them as its walls and its ceiling, which shows one texel; a wall uses one, facing
    the camera, and hides the others behind it; other places have them at a point under the world.
    """
    uv = np.tile(_QUAD_UV, (WALLS, 1))
    if background.kind in ("empty", "outdoor"):
        return np.tile(_NOWHERE_M, (4 * WALLS, 1)), uv
    if background.kind == "room":
        corners = _room(background)
        for k in range(WALLS - 1):
            quad = corners[4 * k : 4 * k + 4]
            across, up = np.linalg.norm(quad[1] - quad[0]), np.linalg.norm(quad[3] - quad[0])
            uv[4 * k : 4 * k + 4] *= np.array([across, up]) / (2 * _WALL_REPEAT_M)
        uv[-4:] = 0.5
        return corners, uv
    if background.kind == "photo":
        return _photo(background, camera), uv
    return _wall(background, camera, _WALL_HALF_M, _WALL_HALF_M), (
        uv * 2 * _WALL_HALF_M / _WALL_REPEAT_M
    )


def floor_geometry(background: Background) -> tuple[Array, Array]:
    """Corners (4, 3) of the floor or ground at y = 0, and their texture coordinates (4, 2)."""
    if background.kind == "room":
        low, high = room_box(background)
    elif background.kind == "outdoor":
        centre = np.array(background.centre_m)
        low, high = centre - _GROUND_HALF_M, centre + _GROUND_HALF_M
    else:
        return np.tile(_NOWHERE_M, (4, 1)), _QUAD_UV
    flat = low[[0, 2]] + _QUAD_UV[:, [0, 1]] * (high - low)[[0, 2]]
    corners = np.stack([flat[:, 0], np.zeros(4), flat[:, 1]], axis=1)[::-1]
    return corners, corners[:, [0, 2]] / _FLOOR_REPEAT_M


def _wall(background: Background, camera: Camera, half_x: float, half_y: float) -> Array:
    frame = camera.T[:3, :3]
    right, up, forward = frame[:, 0], -frame[:, 1], frame[:, 2]
    middle = np.array(background.centre_m)
    # Behind the point looked at, along the optical axis.
    middle = middle + forward * background.distance_m
    signs = 2 * _QUAD_UV - 1
    quad = middle + half_x * signs[:, :1] * right + half_y * signs[:, 1:] * up
    hidden = quad + forward * 0.5
    return np.concatenate([quad, *[hidden] * (WALLS - 1)])


def _photo(background: Background, camera: Camera) -> Array:
    """Cover the frame with a picture, with a margin to shift it by ``crop``."""
    away = np.array(background.centre_m) - camera.position
    z = float(away @ camera.T[:3, 2]) + background.distance_m
    half = 0.75 * np.array([camera.width / camera.fx, camera.height / camera.fy]) * z
    half[:] = half.max()
    quad = _wall(background, camera, float(half[0]), float(half[1]))
    side, up = camera.T[:3, 0], -camera.T[:3, 1]
    crop = 0.4 * (np.array(background.crop) - 0.5)
    # The wall is centred under the point looked at; the frame is not.
    centre = np.array(background.centre_m) + camera.T[:3, 2] * background.distance_m
    seen = camera.position + camera.T[:3, 2] * z
    return np.asarray(quad + (seen - centre) + half[0] * (crop[0] * side + crop[1] * up))


def _room(room: Background) -> Array:
    (x0, y0, z0), (x1, y1, z1) = room_box(room)
    return np.array(
        [
            [x0, y0, z0], [x1, y0, z0], [x1, y1, z0], [x0, y1, z0],
            [x1, y0, z1], [x0, y0, z1], [x0, y1, z1], [x1, y1, z1],
            [x0, y0, z1], [x0, y0, z0], [x0, y1, z0], [x0, y1, z1],
            [x1, y0, z0], [x1, y0, z1], [x1, y1, z1], [x1, y1, z0],
            [x0, y1, z0], [x1, y1, z0], [x1, y1, z1], [x0, y1, z1],
        ]
    )  # fmt: skip
