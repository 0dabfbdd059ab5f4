"""Geometry and procedural texture of walls: one mesh of six quads, whatever the kind."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft, special

from synthgen.geometry.cameras import Camera
from synthgen.sampling.streams import stream
from synthgen.scene import Background

Array = NDArray[np.float64]
Image = NDArray[np.float32]

TEXTURE_PX = 512
QUADS = 6
# Corner order of a quad seen from its front: lower left, lower right, upper right, upper left.
_UV = np.tile(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32), (QUADS, 1))
_WALL_HALF_M = 6.0
_WALL_REPEAT_M = 0.8
_NOWHERE_M = np.array([0.0, -50.0, 0.0])


def wall_triangles() -> NDArray[np.uint32]:
    """Triangles (12, 3) of the six quads."""
    base = 4 * np.arange(QUADS)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return np.asarray(base.reshape(-1, 3), dtype=np.uint32)


def wall_geometry(background: Background, camera: Camera) -> tuple[Array, NDArray[np.float32]]:
    """Corners (24, 3) of the six quads, world, metres, and their texture coordinates (24, 2).

    A room uses all six as the inside of a box; a wall uses one, facing the camera, and hides the
    others behind it; nothing has them shrunk to a point under the world.
    """
    if background.kind == "empty":
        return np.tile(_NOWHERE_M, (4 * QUADS, 1)), _UV
    if background.kind == "room":
        corners = _room(np.array(background.centre_m), background.distance_m)
        return corners, (_UV * 2 * background.distance_m / _WALL_REPEAT_M / 3).astype(np.float32)
    corners = _wall(background, camera)
    return corners, (_UV * 2 * _WALL_HALF_M / _WALL_REPEAT_M).astype(np.float32)


def _wall(background: Background, camera: Camera) -> Array:
    frame = camera.T[:3, :3]
    right, up, forward = frame[:, 0], -frame[:, 1], frame[:, 2]
    middle = np.array(background.centre_m)
    # Behind the point looked at, along the optical axis.
    middle = middle + forward * background.distance_m
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * _WALL_HALF_M
    quad = middle + signs[:, :1] * right + signs[:, 1:] * up
    hidden = quad + forward * 0.5
    return np.concatenate([quad, *[hidden] * (QUADS - 1)])


def _room(centre: Array, half: float) -> Array:
    low, high = centre - half, centre + half
    low[1] = 0.0
    x0, y0, z0 = low
    x1, y1, z1 = high
    return np.array(
        [
            [x0, y0, z0], [x1, y0, z0], [x1, y1, z0], [x0, y1, z0],
            [x1, y0, z1], [x0, y0, z1], [x0, y1, z1], [x1, y1, z1],
            [x0, y0, z1], [x0, y0, z0], [x0, y1, z0], [x0, y1, z1],
            [x1, y0, z0], [x1, y0, z1], [x1, y1, z1], [x1, y1, z0],
            [x0, y0, z1], [x1, y0, z1], [x1, y0, z0], [x0, y0, z0],
            [x0, y1, z0], [x1, y1, z0], [x1, y1, z1], [x0, y1, z1],
        ]
    )  # fmt: skip


def wall_texture(background: Background) -> Image:
    """Tileable reflectance (512, 512, 3) float32, linear, from the background's seed."""
    rng = stream(background.seed, "sample", 0, 0, "wall texture")
    pattern = 0.15 * _cloud(rng, 24)
    if background.kind != "plain":
        pattern = pattern + _pattern(rng)
    share = np.clip(pattern, 0, 1)[..., None]
    first, second = (
        np.array(c, np.float32) for c in (background.colour_rgb, background.accent_rgb)
    )
    grain = 1 + 0.05 * _cloud(rng, 2)[..., None]
    return np.asarray(np.clip((first + share * (second - first)) * grain, 0.01, 0.95))


def _pattern(rng: np.random.Generator) -> Image:
    """Stripes, checks, tiles with joints, blotches or grain."""
    kind = ("stripes", "checks", "tiles", "blotches", "grain")[rng.integers(5)]
    steps = np.arange(TEXTURE_PX, dtype=np.float32) / TEXTURE_PX
    y, x = steps[:, None], steps[None]
    n = int(rng.integers(2, 9))
    if kind == "stripes":
        share = np.float32(rng.uniform(0.2, 0.6))
        return 0.9 * ((x * n + 0.02 * _cloud(rng, 32)) % 1 < share).astype(np.float32)
    if kind == "checks":
        return np.asarray(0.9 * ((np.floor(x * 2 * n) + np.floor(y * 2 * n)) % 2), np.float32)
    if kind == "tiles":
        joint = ((x * n) % 1 < 0.04) | ((y * n) % 1 < 0.04)
        return np.where(joint, np.float32(1), 0.12 * _cloud(rng, 48))
    if kind == "blotches":
        return np.asarray(special.expit(4 * _cloud(rng, int(rng.integers(8, 60)))))
    streaks = rng.standard_normal((256, 8)).astype(np.float32)
    wide = np.asarray(cv2.resize(streaks, (TEXTURE_PX,) * 2), np.float32)
    return 0.4 + 0.3 * wide + 0.1 * _cloud(rng, 4)


def _cloud(rng: np.random.Generator, size_px: int) -> Image:
    """Tileable band-limited noise (512, 512) with unit standard deviation.

    White noise under a Gaussian of ``2 size_px``, drawn as the few Fourier coefficients that pass.
    """
    width = TEXTURE_PX / (2 * size_px)
    top = min(TEXTURE_PX // 2 - 1, math.ceil(3.5 * width))
    fy, fx = np.arange(-top, top + 1), np.arange(top + 1)
    drawn = rng.standard_normal((2 * top + 1, top + 1, 2), dtype=np.float32) @ [1, 1j]
    drawn *= np.exp(-0.5 * (fx[None] ** 2 + fy[:, None] ** 2) / width**2)
    drawn[top, 0] = 0  # no mean
    spectrum = np.zeros((TEXTURE_PX, TEXTURE_PX // 2 + 1), dtype=np.complex64)
    spectrum[fy, : top + 1] = drawn
    noise = fft.irfft2(spectrum, s=(TEXTURE_PX, TEXTURE_PX))
    return np.asarray(noise / noise.std(), dtype=np.float32)
