"""Rigid transforms ``T_dst_from_src`` (4, 4); points are rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import matrix_from_axis_angle


def apply(transform: NDArray[Any], points: NDArray[Any]) -> NDArray[np.float64]:
    """Return ``points @ R.T + t`` for points (..., 3)."""
    T = np.asarray(transform, dtype=np.float64)
    result: NDArray[np.float64] = np.asarray(points, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]
    return result


def invert(transform: NDArray[Any]) -> NDArray[np.float64]:
    """Return the inverse of a rigid transform, exactly rigid again."""
    T = np.asarray(transform, dtype=np.float64)
    inverse = np.eye(4)
    inverse[:3, :3] = T[:3, :3].T
    inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return inverse


def look_at(
    eye: NDArray[Any], target: NDArray[Any], up: tuple[float, float, float] = (0.0, 1.0, 0.0)
) -> NDArray[np.float64]:
    """Return ``T_world_from_camera`` of an OpenCV camera (x right, y down, z forward).

    Parameters
    ----------
    eye, target : (3,) float
        World positions, metres; the optical axis runs from ``eye`` through ``target``.
    up : tuple of float
        World direction that appears upwards in the image.

    Raises
    ------
    ShapeError
        If ``eye`` equals ``target`` or ``up`` is parallel to the line of sight.
    """
    position = np.asarray(eye, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - position
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    if np.linalg.norm(right) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
        raise ShapeError(f"cannot look from {eye} at {target} with up {up}: no image plane")
    forward = forward / np.linalg.norm(forward)
    right = right / np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = position
    return T


def turn_about(
    centre: NDArray[Any], axis_angle: NDArray[Any], shift: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotation (3, 3) and translation (3,) of a turn about ``centre`` and a shift."""
    rotation = matrix_from_axis_angle(axis_angle)
    middle = np.asarray(centre, dtype=np.float64)
    return rotation, middle - rotation @ middle + np.asarray(shift, dtype=np.float64)
