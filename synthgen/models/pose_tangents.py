"""How local rotations and pose features move with each number of a pose, exact at zero.

A joint is driven by at most three numbers. Number c of joint j turns it by the angular velocity
``omega[j, c]``: dR = [omega]x R, in the frame of the parent. For axis-angle that is column c of
the left Jacobian of SO(3), whose series make first *and* second derivatives right at zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.geometry.rotations import axis_angle_from_matrix, cross_matrix, matrix_from_axis_angle
from synthgen.models.constrained import ConstrainedTree
from synthgen.models.pose_features import hamilton, quaternion_feature

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
# Below this angle the quotients' series are used: their neglected terms are below 1e-16 there,
# while the quotients themselves have lost three digits to cancellation.
_SERIES = 0.1


@dataclass(frozen=True, eq=False)
class Tangents:
    """Derivatives of one sample's local rotations.

    Attributes
    ----------
    column : (K, 3) int64
        Which number of the pose drives the joint, -1 for none.
    omega : (K, 3, 3) float64
        Row c: angular velocity by number c, parent's frame.
    feature : (K, 3, q) float64
        Row c: derivative of the joint's pose features by number c.
    """

    column: NDArray[np.int64]
    omega: Array
    feature: Array


def tangents(model: BodyModel, pose: Array, rotations: Array, q: int) -> Tangents:
    """Differentiate one pose: (K, 3) axis-angle, (K, 3, 3) matrices or (P,) constrained angles.

    Matrices are differentiated by a rotation vector multiplied from the left, at zero.
    """
    k = len(rotations)
    if model.axis_meta is not None and pose.ndim == 1:
        return _constrained(model.axis_meta, pose, official=model.constrained == "official")
    omega, feature = np.empty((k, 3, 3)), np.empty((k, 3, q))
    if pose.ndim == 2:
        of_vectors(pose, rotations, omega, feature)
    else:
        omega[:] = np.eye(3)
        feature[:] = _of_matrices(rotations, q)
    return Tangents(np.arange(3 * k).reshape(k, 3), omega, feature)


@njit(cache=True, error_model="numpy")
def of_vectors(theta: Any, rotations: Any, omega: Any, feature: Any) -> None:
    """Axis-angle (N, 3) and its rotations -> omega (N, 3, 3), feature (N, 3, q), q 9 or 4."""
    for k in range(theta.shape[0]):
        x, y, z = theta[k, 0], theta[k, 1], theta[k, 2]
        t2 = x * x + y * y + z * z
        t = math.sqrt(t2)
        half = 0.5 * math.sin(0.5 * t) / (0.5 * t) if t > 1e-8 else 0.5
        b = 2 * half * half
        if t < _SERIES:
            c = 1 / 6 - t2 * (1 / 120 - t2 * (1 / 5040 - t2 / 362880))
            d = -1 / 24 + t2 * (1 / 960 - t2 * (1 / 107520 - t2 / 23224320))
        else:
            c = (t - math.sin(t)) / (t2 * t)
            d = (0.5 * math.cos(0.5 * t) - half) / t2
        o = omega[k]
        o[0, 0], o[1, 1], o[2, 2] = 1 - c * (t2 - x * x), 1 - c * (t2 - y * y), 1 - c * (t2 - z * z)
        o[0, 1], o[1, 0] = c * x * y + b * z, c * x * y - b * z
        o[0, 2], o[2, 0] = c * x * z - b * y, c * x * z + b * y
        o[1, 2], o[2, 1] = c * y * z + b * x, c * y * z - b * x
        for i in range(3):
            f = feature[k, i]
            if feature.shape[2] == 9:
                r, wx, wy, wz = rotations[k], o[i, 0], o[i, 1], o[i, 2]
                for j in range(3):
                    f[j] = wy * r[2, j] - wz * r[1, j]
                    f[3 + j] = wz * r[0, j] - wx * r[2, j]
                    f[6 + j] = wx * r[1, j] - wy * r[0, j]
            else:
                own = theta[k, i]
                for j in range(3):
                    f[j] = d * own * theta[k, j]
                f[i] += half
                f[3] = -0.5 * half * own


def _of_matrices(rotations: Array, q: int) -> Array:
    turns = cross_matrix(np.eye(3))
    if q == 9:
        return np.asarray(turns @ rotations[:, None]).reshape(len(rotations), 3, 9)
    quaternion = quaternion_feature(axis_angle_from_matrix(rotations)) + _IDENTITY
    return _turned(np.eye(3), quaternion[:, None])


def _turned(omega: Array, quaternion: Array) -> Array:
    """Differentiate a quaternion whose rotation turns by omega from the left."""
    pure = np.concatenate([0.5 * omega, np.zeros((*omega.shape[:-1], 1))], axis=-1)
    return hamilton(*np.broadcast_arrays(pure, quaternion))


def _constrained(tree: ConstrainedTree, pose: Array, *, official: bool) -> Tangents:
    """Spherical joints, then hinges, then double hinges; at last in the order of the joints."""
    ball = np.ascontiguousarray(pose[tree.spherical])
    s, h, d = len(ball), len(tree.hinge), len(tree.double_first)
    column = np.full((s + h + d, 3), -1, dtype=np.int64)
    omega, feature = np.zeros((s + h + d, 3, 3)), np.zeros((s + h + d, 3, 4))
    column[:s], column[s : s + h, 0] = tree.spherical, tree.hinge
    column[s + h :, 0], column[s + h :, 1] = tree.double_first, tree.double_second
    of_vectors(ball, matrix_from_axis_angle(ball), omega[:s], feature[:s])
    sign = 1.0 if official else -1.0  # official correctives see the opposite of the rotation
    omega[s : s + h, 0] = -tree.hinge_axis
    feature[s : s + h, 0] = _about(sign * tree.hinge_axis, pose[tree.hinge])[1]
    first, second = pose[tree.double_first], pose[tree.double_second]
    omega[s + h :, 0] = -tree.double_first_axis
    turned = matrix_from_axis_angle(-first[:, None] * tree.double_first_axis)
    omega[s + h :, 1] = -np.einsum("nij,nj->ni", turned, tree.double_second_axis)
    q1, d1 = _about(sign * tree.double_first_axis, first)
    q2, d2 = _about(sign * tree.double_second_axis, second)
    if official:
        q1, q2 = q1 - _IDENTITY, q2 - _IDENTITY
    feature[s + h :, 0], feature[s + h :, 1] = hamilton(d1, q2), hamilton(q1, d2)
    return Tangents(column[tree.order], omega[tree.order], feature[tree.order])


def _about(axis: Array, angle: Array) -> tuple[Array, Array]:
    """Quaternions (N, 4) of turns about axes (N, 3) of any length, and their derivatives."""
    length = np.linalg.norm(axis, axis=-1)
    q = quaternion_feature(angle[:, None] * axis) + _IDENTITY
    rate = 0.5 * np.concatenate(
        [axis * np.cos(0.5 * angle * length)[:, None],
         (-length * np.sin(0.5 * angle * length))[:, None]], axis=1,
    )  # fmt: skip
    return q, rate
