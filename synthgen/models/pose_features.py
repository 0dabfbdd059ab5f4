"""What pose correctives see, in NumPy, float64: R - I, or quaternions minus the identity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from synthgen.models.constrained import ConstrainedTree

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def quaternion_feature(axis_angle: Array) -> Array:
    """Return (x, y, z, w - 1) of rotations (..., 3), with series at zero; (..., 4)."""
    half = 0.5 * np.linalg.norm(axis_angle, axis=-1, keepdims=True)
    small = half < 1e-4
    safe = np.where(small, 1.0, half)
    scale = 0.5 * np.where(small, 1 - half**2 / 6, np.sin(safe) / safe)
    # cos(h) - 1 = -2 sin^2(h / 2): no cancellation at small angles
    return np.concatenate([scale * axis_angle, -2 * np.sin(half / 2) ** 2], axis=-1)


def hamilton(p: Array, q: Array) -> Array:
    """Product of quaternions (..., 4), scalar last."""
    pv, pw, qv, qw = p[..., :3], p[..., 3:], q[..., :3], q[..., 3:]
    vector = pw * qv + qw * pv + np.cross(pv, qv)
    scalar = pw * qw - np.sum(pv * qv, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def rotations_and_features(model: BodyModel, pose: Array) -> tuple[Array, Array]:
    """Return local rotations (B, K, 3, 3) and features (B, K, q) of every joint, root included.

    ``pose`` is (B, K, 3) axis-angle, (B, K, 3, 3) matrices or (B, P) constrained angles; q is 9
    (row-major R - I) for the SMPL family and 4 for STAR and SUPR.
    """
    if model.axis_meta is not None and pose.ndim == 2:
        if model.constrained not in ("official", "consistent"):
            raise ModelError(
                f"constrained={model.constrained!r}; allowed are 'official' (as published) and "
                "'consistent' (hinges turn and correct the same way)"
            )
        return _constrained(model.axis_meta, pose, official=model.constrained == "official")
    rotations = pose if pose.ndim == 4 else matrix_from_axis_angle(pose)
    if model.family in ("mano", "smplh"):
        feature = (rotations - np.eye(3)).reshape(*rotations.shape[:2], 9)
    else:
        vectors = axis_angle_from_matrix(pose) if pose.ndim == 4 else pose
        feature = quaternion_feature(vectors)
    return rotations, feature


def feature_joints(model: BodyModel) -> tuple[int, int]:
    """Return the first joint whose features drive correctives, and features per joint (9 or 4).

    A SUPR file holds 4 K columns (the published code) or 4 (K - 1) (the paper's Table 3).
    """
    if model.family in ("mano", "smplh"):
        return 1, 9
    k, columns = len(model.parents), model.posedirs.shape[2]
    return (0 if model.family == "supr" and columns == 4 * k else 1), 4


def _constrained(tree: ConstrainedTree, pose: Array, *, official: bool) -> tuple[Array, Array]:
    ball = pose[:, tree.spherical]
    hinge = pose[:, tree.hinge, None] * tree.hinge_axis
    first = pose[:, tree.double_first, None] * tree.double_first_axis
    second = pose[:, tree.double_second, None] * tree.double_second_axis
    turn = matrix_from_axis_angle
    rotations = np.concatenate([turn(ball), turn(-hinge), turn(-first) @ turn(-second)], axis=1)
    if official:
        product = hamilton(quaternion_feature(first), quaternion_feature(second))
        hinges = quaternion_feature(hinge)
    else:
        q = [quaternion_feature(-r) + _IDENTITY for r in (first, second)]
        product = hamilton(*q) - _IDENTITY
        hinges = quaternion_feature(-hinge)
    feature = np.concatenate([quaternion_feature(ball), hinges, product], axis=1)
    return rotations[:, tree.order], feature[:, tree.order]
