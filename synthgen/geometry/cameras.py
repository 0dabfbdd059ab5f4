"""Pinhole cameras with Brown-Conrady distortion, OpenCV convention.

x right, y down, z forward; pixel centres at integers; ``cx = W/2 - 0.5`` is the image centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.normals import unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """One calibrated view.

    Attributes
    ----------
    width, height : int
        Pixels.
    fx, fy, cx, cy : float
        Pixels; integer pixel centres.
    distortion : tuple of float
        (5,) k1 k2 p1 p2 k3, as OpenCV.
    T_world_from_camera : tuple of tuple of float
        (4, 4) rigid transform, metres; points are rows, ``p_world = p_camera @ R.T + t``.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]
    T_world_from_camera: tuple[tuple[float, ...], ...]

    @property
    def K(self) -> Array:
        """Intrinsic matrix (3, 3), pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], np.float64)

    @property
    def T(self) -> Array:
        """``T_world_from_camera`` (4, 4) as an array."""
        return np.array(self.T_world_from_camera, dtype=np.float64)

    @property
    def position(self) -> Array:
        """Optical centre (3,), world, metres."""
        return self.T[:3, 3]


def camera_from_K(
    K: NDArray[Any],
    width: int,
    height: int,
    T_world_from_camera: NDArray[Any] | None = None,
    distortion: NDArray[Any] | None = None,
) -> Camera:
    """Build a camera from matrices: K (3, 3), T (4, 4), distortion (5,) or None for zero."""
    k = np.asarray(K, dtype=np.float64)
    if k.shape != (3, 3) or k[0, 1] != 0:
        raise ShapeError(f"K must be (3, 3) without skew, got shape {k.shape}: {k.tolist()}")
    T = np.eye(4) if T_world_from_camera is None else np.asarray(T_world_from_camera, np.float64)
    k1, k2, p1, p2, k3 = (0.0,) * 5 if distortion is None else (float(v) for v in distortion)
    rows = tuple(tuple(float(v) for v in row) for row in T)
    fx, fy, cx, cy = (float(v) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2]))
    return Camera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3), rows)


def to_camera(camera: Camera, points: NDArray[Any]) -> Array:
    """World points (..., 3) in the camera's frame, metres."""
    T = camera.T
    result: Array = (np.asarray(points, dtype=np.float64) - T[:3, 3]) @ T[:3, :3]
    return result


def to_world(camera: Camera, points: NDArray[Any]) -> Array:
    """Camera-frame points (..., 3) in the world, metres."""
    T = camera.T
    result: Array = np.asarray(points, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]
    return result


def project(camera: Camera, points: NDArray[Any]) -> tuple[Array, Array]:
    """Project world points into the distorted image.

    Parameters
    ----------
    camera : Camera
    points : (..., 3) float
        World, metres.

    Returns
    -------
    pixels : (..., 2) float64
        Integer pixel centres; meaningless where ``z <= 0``.
    z : (...) float64
        Depth along the optical axis, metres.
    """
    local = to_camera(camera, points)
    z = local[..., 2]
    safe = np.where(np.abs(z) > 1e-12, z, 1e-12)
    xy = distort(camera, local[..., :2] / safe[..., None])
    return xy * [camera.fx, camera.fy] + [camera.cx, camera.cy], z


def distort(camera: Camera, xy: NDArray[Any]) -> Array:
    """Apply Brown-Conrady distortion to normalised image coordinates (..., 2)."""
    points = np.asarray(xy, dtype=np.float64)
    if not any(camera.distortion):
        return points
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([xd, yd], axis=-1)


def undistort(camera: Camera, xy: NDArray[Any], tolerance: float = 1e-10) -> Array:
    """Invert :func:`distort` by fixed-point iteration.

    Raises
    ------
    ShapeError
        If the iteration does not settle: the distortion folds the image inside the frame.
    """
    target = np.asarray(xy, dtype=np.float64)
    if not any(camera.distortion):
        return target
    guess = target.copy()
    for _ in range(200):
        step = target - distort(camera, guess)
        guess = guess + step
        if np.abs(step).max(initial=0.0) < tolerance:
            return guess
        if np.abs(guess).max() > 1e3:  # it runs away
            break
    raise ShapeError(
        f"distortion {camera.distortion} cannot be inverted over the frame; use smaller values"
    )


def pixel_rays(camera: Camera) -> tuple[Array, Array]:
    """Rays through the pixel centres.

    Returns
    -------
    origin : (3,) float64
        World, metres.
    directions : (H, W, 3) float64
        World, unit length.
    """
    local = np.ones((camera.height, camera.width, 3))
    local[..., 0] = (np.arange(camera.width) - camera.cx) / camera.fx
    local[..., 1] = (np.arange(camera.height)[:, None] - camera.cy) / camera.fy
    local[..., :2] = undistort(camera, local[..., :2])
    return camera.position, unit(local.reshape(-1, 3) @ camera.T[:3, :3].T).reshape(local.shape)
