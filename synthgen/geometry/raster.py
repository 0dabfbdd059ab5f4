"""A plain z-buffer at pixel centres: the reference that renders are checked against.

Independent of Mitsuba. One ray per pixel centre, exact in float64: a pixel belongs to the nearest
triangle that its centre lies in.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.cameras import Camera, distort, to_camera

NEAR_M = 1e-3


def rasterise(
    vertices: NDArray[Any], faces: NDArray[Any], camera: Camera
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Draw triangles with hidden surfaces removed.

    Parameters
    ----------
    vertices : (V, 3) float
        World, metres.
    faces : (F, 3) int
    camera : Camera
        Edges between distorted corners are drawn straight: with distortion, triangles must be
        small, which is what drawn surfaces are (:func:`split` makes others so).

    Returns
    -------
    face_id : (H, W) int32
        -1 where nothing is hit.
    barycentric : (H, W, 3) float64
        Perspective-correct, zero where nothing is hit.
    depth_z_m : (H, W) float64
        Along the optical axis, 0 where nothing is hit.

    Raises
    ------
    ShapeError
        If a triangle reaches behind the camera.
    """
    xy, inverse_z, triangles = _in_picture(vertices, faces, camera)
    shape = (camera.height, camera.width)
    face_id = np.full(shape, -1, dtype=np.int32)
    barycentric = np.zeros((*shape, 3))
    inverse_depth = np.zeros(shape)
    _draw(xy, inverse_z, triangles, face_id, barycentric, inverse_depth)
    depth = np.divide(1.0, inverse_depth, out=np.zeros(shape), where=face_id >= 0)
    return face_id, barycentric, depth


def pierce(
    vertices: NDArray[Any], faces: NDArray[Any], camera: Camera, pixels: NDArray[Any]
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Find the nearest triangle on the rays through some points of the picture.

    Parameters
    ----------
    vertices, faces, camera
        As for :func:`rasterise`, which does this at every pixel's centre.
    pixels : (n, 2) float
        Anywhere, fractions too.

    Returns
    -------
    face_id (n,), barycentric (n, 3), depth_z_m (n,)
        As :func:`rasterise` has them per pixel.
    """
    xy, inverse_z, triangles = _in_picture(vertices, faces, camera)
    n = len(pixels)
    face_id = np.full(n, -1, dtype=np.int32)
    barycentric, inverse_depth = np.zeros((n, 3)), np.zeros(n)
    at = np.ascontiguousarray(pixels, dtype=np.float64)
    _pierce(xy, inverse_z, triangles, at, face_id, barycentric, inverse_depth)
    depth = np.divide(1.0, inverse_depth, out=np.zeros(n), where=face_id >= 0)
    return face_id, barycentric, depth


def _in_picture(vertices: NDArray[Any], faces: NDArray[Any], camera: Camera) -> tuple[Any, ...]:
    """Return pixels (V, 2) and inverse depths (V,) of the vertices, and the triangles."""
    local = to_camera(camera, vertices)
    triangles = np.asarray(faces, dtype=np.int64)
    if len(triangles) and local[triangles][..., 2].min() < NEAR_M:
        raise ShapeError(f"a triangle is nearer to the camera than {NEAR_M} m, or behind it")
    xy = distort(camera, local[:, :2] / local[:, 2:])
    return xy * [camera.fx, camera.fy] + [camera.cx, camera.cy], 1.0 / local[:, 2], triangles


def split(vertices: NDArray[Any], faces: NDArray[Any], times: int = 1) -> tuple[Any, Any]:
    """Split triangles into four flat ones, ``times`` over; corners stay, none are shared."""
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(faces)]
    for _ in range(times):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


@njit(cache=True)
def _draw(
    xy: Any, inverse_z: Any, triangles: Any, face_id: Any, barycentric: Any, nearest: Any
) -> None:
    height, width = face_id.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay, bx, by, cx, cy = xy[a, 0], xy[a, 1], xy[b, 0], xy[b, 1], xy[c, 0], xy[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        x0 = max(0, int(np.ceil(min(ax, bx, cx))))
        x1 = min(width - 1, int(np.floor(max(ax, bx, cx))))
        y0 = max(0, int(np.ceil(min(ay, by, cy))))
        y1 = min(height - 1, int(np.floor(max(ay, by, cy))))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                wa = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
                wb = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
                wc = 1.0 - wa - wb
                if wa < 0.0 or wb < 0.0 or wc < 0.0:
                    continue
                value = wa * inverse_z[a] + wb * inverse_z[b] + wc * inverse_z[c]
                if value > nearest[y, x]:
                    nearest[y, x] = value
                    face_id[y, x] = t
                    barycentric[y, x, 0] = wa * inverse_z[a] / value
                    barycentric[y, x, 1] = wb * inverse_z[b] / value
                    barycentric[y, x, 2] = wc * inverse_z[c] / value


@njit(cache=True)
def _pierce(
    xy: Any, inverse_z: Any, triangles: Any, at: Any, face_id: Any, barycentric: Any, nearest: Any
) -> None:
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay, bx, by, cx, cy = xy[a, 0], xy[a, 1], xy[b, 0], xy[b, 1], xy[c, 0], xy[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        for k in range(len(at)):
            x, y = at[k]
            if x < min(ax, bx, cx) or x > max(ax, bx, cx):
                continue
            wa = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / area
            wb = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / area
            wc = 1.0 - wa - wb
            if wa < 0.0 or wb < 0.0 or wc < 0.0:
                continue
            value = wa * inverse_z[a] + wb * inverse_z[b] + wc * inverse_z[c]
            if value > nearest[k]:
                nearest[k], face_id[k] = value, t
                barycentric[k, 0] = wa * inverse_z[a] / value
                barycentric[k, 1] = wb * inverse_z[b] / value
                barycentric[k, 2] = wc * inverse_z[c] / value
