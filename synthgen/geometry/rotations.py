"""Rotations as axis-angle vectors and matrices, exact at zero."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError

# Below this angle the trigonometric quotients are replaced by their series, whose first
# neglected term is below float64 resolution there.
_SMALL = 1e-4


def matrix_from_axis_angle(axis_angle: NDArray[Any]) -> NDArray[np.float64]:
    """Rodrigues' formula, with series for small angles so that all derivatives are right at 0.

    Parameters
    ----------
    axis_angle : (..., 3) float
        Rotation axis times angle, radians.

    Returns
    -------
    (..., 3, 3) float64
    """
    r = np.asarray(axis_angle, dtype=np.float64)
    if r.shape[-1:] != (3,):
        raise ShapeError(f"axis_angle has shape {r.shape}; it must end in 3")
    squared = np.sum(r * r, axis=-1)
    angle = np.sqrt(squared)
    small = angle < _SMALL
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1 - squared / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - squared / 24, (1 - np.cos(safe)) / (safe * safe))
    k = cross_matrix(r)
    result: NDArray[np.float64] = np.eye(3) + a[..., None, None] * k + b[..., None, None] * (k @ k)
    return result


def cross_matrix(vector: NDArray[Any]) -> NDArray[np.float64]:
    """Return the skew matrix K (..., 3, 3) with ``K @ x == cross(vector, x)``."""
    v = np.asarray(vector, dtype=np.float64)
    k = np.zeros((*v.shape[:-1], 3, 3))
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    k[..., 1, 0], k[..., 2, 0], k[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return k


def axis_angle_from_matrix(matrix: NDArray[Any]) -> NDArray[np.float64]:
    """Return the axis-angle vector (..., 3), angle in [0, pi], of rotation matrices (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    m = np.asarray(matrix, dtype=np.float64)
    if m.shape[-2:] != (3, 3):
        raise ShapeError(f"matrix has shape {m.shape}; it must end in (3, 3)")
    vectors = Rotation.from_matrix(m.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(vectors, dtype=np.float64).reshape(m.shape[:-1])


def swing_between(source: NDArray[Any], target: NDArray[Any]) -> NDArray[np.float64]:
    """Return the smallest rotation (..., 3, 3) that takes direction ``source`` to ``target``.

    Both (..., 3), of any length; opposite directions have no smallest rotation and are refused.
    """
    a = np.asarray(source, dtype=np.float64)
    b = np.asarray(target, dtype=np.float64)
    a = a / np.linalg.norm(a, axis=-1, keepdims=True)
    b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    cosine = np.sum(a * b, axis=-1)
    if np.any(cosine < -1 + 1e-9):
        raise ShapeError("source and target point in opposite directions; turn in two steps")
    k = cross_matrix(np.cross(a, b))
    result: NDArray[np.float64] = np.eye(3) + k + k @ k / (1 + cosine)[..., None, None]
    return result
