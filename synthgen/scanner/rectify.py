"""Rectification of a camera pair by its calibration: rows that correspond, disparity to depth.

A scanner knows only its nominal calibration, so every function here takes nominal cameras; how far
the true ones lead it astray is what :mod:`synthgen.scanner.calibration` measures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.cameras import Camera, to_world, undistort
from synthgen.scanner.calibration import rectifying_rotation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rectified:
    """A pair of cameras turned so that a point lies in the same row of both pictures.

    ``disparity = x_left - x_right``, pixels; zero at the target's depth.

    Attributes
    ----------
    left, right : Camera
        The nominal cameras, with distortion.
    camera : Camera
        The rectified left view, a pinhole; its frame is the pair's frame.
    cx_right : float
        Principal point of the rectified right view, pixels; fx, fy, cy are the left's.
    baseline_m : float
    """

    left: Camera
    right: Camera
    camera: Camera
    cx_right: float
    baseline_m: float

    @property
    def offset_px(self) -> float:
        """What is added to a disparity to make it ``f * baseline / z``."""
        return self.cx_right - self.camera.cx

    def depth(self, disparity: NDArray[Any]) -> NDArray[Any]:
        """Depth along the rectified axis, metres, of disparities in pixels; NaN stays NaN."""
        near = np.maximum(disparity + self.offset_px, 1e-6)
        return np.asarray(self.camera.fx * self.baseline_m / near)

    def disparity(self, depth_z_m: NDArray[Any] | float) -> NDArray[Any]:
        """Disparity, pixels, of depths in metres."""
        return np.asarray(self.camera.fx * self.baseline_m / depth_z_m - self.offset_px)

    @property
    def Q(self) -> Array:
        """(4, 4): ``Q @ (x, y, disparity, 1)`` is the homogeneous point in the pair's frame."""
        c = self.camera
        return np.array(
            [
                [1, 0, 0, -c.cx],
                [0, 1, 0, -c.cy],
                [0, 0, 0, c.fx],
                [0, 0, 1 / self.baseline_m, self.offset_px / self.baseline_m],
            ]
        )

    def points(self, x: NDArray[Any], y: NDArray[Any], disparity: NDArray[Any]) -> Array:
        """World points (..., 3), metres, of rectified left pixels with disparities."""
        z = self.depth(disparity)
        c = self.camera
        x, y, z = np.broadcast_arrays(x, y, z)
        return to_world(c, np.stack([(x - c.cx) / c.fx * z, (y - c.cy) / c.fy * z, z], axis=-1))


def rectify(left: Camera, right: Camera, target: NDArray[Any] | None = None) -> Rectified:
    """Turn a pair onto its common baseline.

    Parameters
    ----------
    left, right : Camera
        Nominal; of equal size. Any baseline direction does, the rectified x axis follows it.
    target : (3,) float, world metres, optional
        Lands in the centre of both rectified pictures; default is the point on the pair's middle
        axis that is as deep as the world's origin, the centre of a rig's working volume.

    Raises
    ------
    ShapeError
        If the sizes differ, the centres coincide, or the target is behind the pair.
    """
    if (left.width, left.height) != (right.width, right.height):
        raise ShapeError(
            f"cameras of {left.width}x{left.height} and {right.width}x{right.height} pixels; "
            "a stereo pair needs equal sizes"
        )
    base = right.position - left.position
    length = float(np.linalg.norm(base))
    if length < 1e-6:
        raise ShapeError(f"the pair's centres are {length:.2g} m apart; a baseline is needed")
    T = np.eye(4)
    T[:3, :3] = rectifying_rotation(left, right)
    T[:3, 3] = left.position
    f = (left.fx + right.fx + left.fy + right.fy) / 4
    if target is None:
        middle = (left.position + right.position) / 2
        aim = middle + max(float(-middle @ T[:3, 2]), 2 * length) * T[:3, 2]
    else:
        aim = np.asarray(target, np.float64)
    seen = [(aim - c.position) @ T[:3, :3] for c in (left, right)]
    if min(p[2] for p in seen) <= 0:
        raise ShapeError(f"target {aim.tolist()} lies behind the pair at {left.position.tolist()}")
    cx, cx_right = ((left.width - 1) / 2 - f * p[0] / p[2] for p in seen)
    cy = (left.height - 1) / 2 - f * (seen[0][1] / seen[0][2] + seen[1][1] / seen[1][2]) / 2
    rows = tuple(tuple(float(v) for v in row) for row in T)
    view = Camera(left.width, left.height, f, f, float(cx), float(cy), (0.0,) * 5, rows)
    return Rectified(left, right, view, float(cx_right), length)


def rectify_images(
    pair: Rectified,
    images: tuple[NDArray[Any], NDArray[Any]],
    lower: NDArray[Any] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Resample raw pictures (H, W) into the rectified views, float32, in the raw pictures' unit.

    Lanczos over 8x8 pixels: OpenCV's cubic costs 0.01 mm, this 0.001 mm. The right view is read
    ``lower`` (H, W) pixels further down, where that is given.
    """
    done = []
    for k, image in enumerate(images):
        camera = pair.right if k else pair.left
        if image.shape != (camera.height, camera.width):
            raise ShapeError(
                f"picture of shape {image.shape}; the calibration is for "
                f"({camera.height}, {camera.width})"
            )
        source = np.asarray(image, np.float32)
        maps = remap_tables(pair, k)
        if k and lower is not None:
            maps = _further_down(maps, lower)
        warped = cv2.remap(source, *maps, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
        done.append(np.clip(warped, 0, float(source.max(initial=0))).astype(np.float32))
    return done[0], done[1]


def _further_down(
    maps: tuple[NDArray[np.float32], NDArray[np.float32]], lower: NDArray[Any]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Read smooth tables (H, W) between their rows."""
    height, width = lower.shape
    x = np.tile(np.arange(width, dtype=np.float32), (height, 1))
    y = (np.arange(height)[:, None] + lower).astype(np.float32)
    a, b = (cv2.remap(m, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for m in maps)
    return np.asarray(a, np.float32), np.asarray(b, np.float32)


def remap_tables(pair: Rectified, side: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Raw pixel (x, y) of every rectified pixel of the left (0) or right (1) view."""
    camera = pair.right if side else pair.left
    turn = pair.camera.T[:3, :3].T @ camera.T[:3, :3]
    K = pair.camera.K
    K[0, 2] = pair.cx_right if side else pair.camera.cx
    size = camera.width, camera.height
    k = np.array(camera.distortion)
    x, y = cv2.initUndistortRectifyMap(camera.K, k, turn, K, size, cv2.CV_32FC1)
    return np.asarray(x, np.float32), np.asarray(y, np.float32)


def rectified_pixels(pair: Rectified, side: int, pixels: NDArray[Any]) -> Array:
    """Where raw pixels (N, 2) of the left (0) or right (1) camera lie in the rectified view."""
    camera = pair.right if side else pair.left
    plane = (np.asarray(pixels) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    rays = np.concatenate([undistort(camera, plane), np.ones((len(plane), 1))], axis=1)
    local = rays @ camera.T[:3, :3].T @ pair.camera.T[:3, :3]
    centre = [pair.cx_right if side else pair.camera.cx, pair.camera.cy]
    return np.asarray(local[:, :2] / local[:, 2:] * pair.camera.fx + centre)
