"""Evaluation of a batch: checks, then the kernels; single precision unless asked otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models import kernels
from synthgen.models.arguments import Arguments, checked
from synthgen.models.model import Posed
from synthgen.models.pose_features import rotations_and_features

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel
    from synthgen.models.packed import Packed

Array = NDArray[np.float64]
# Samples and vertices of one matrix product: the basis is read once per so many samples, and what
# a product writes is skinned while it is in the caches.
_SAMPLES, _VERTICES = 256, 196
# From this many samples on, vectorising over samples beats going through them one by one.
_TILED_FROM = 8


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Posed joints of a batch.

    Attributes
    ----------
    coefficients : (B, 1 + n) float64
        1, shape, expression.
    rotations : (B, K, 3, 3) float64, local
    features : (B, K, q) float64
    joints : (B, K, 3) float64, rest pose
    transforms : (B, K, 4, 4) float64, world, translation included
    skin : (B, K, 12)
        Rows of the map of rest points minus the identity, without the translation.
    """

    coefficients: Array
    rotations: Array
    features: Array
    joints: Array
    transforms: Array
    skin: NDArray[Any]


def evaluate(
    model: BodyModel, shape: Any, pose: Any, translation: Any, expression: Any, flat: bool | None
) -> Posed:
    """Evaluate a batch; see ``BodyModel.evaluate``."""
    given = checked(model, shape, pose, translation, expression, flat_hand_mean=flat)
    packed = model.packed
    skeleton = pose_skeleton(model, given, packed)
    vertices = pose_vertices(packed, skeleton, given.translation)
    return Posed(
        vertices=vertices,
        joints=skeleton.transforms[..., :3, 3].astype(np.float32),
        transforms=skeleton.transforms,
    )


def evaluate_joints(
    model: BodyModel, shape: Any, pose: Any, translation: Any, expression: Any, flat: bool | None
) -> NDArray[np.float32]:
    """Evaluate joints alone; see ``BodyModel.evaluate_joints``."""
    given = checked(model, shape, pose, translation, expression, flat_hand_mean=flat)
    skeleton = pose_skeleton(model, given, model.packed)
    return skeleton.transforms[..., :3, 3].astype(np.float32)


def pose_skeleton(model: BodyModel, given: Arguments, packed: Packed) -> Skeleton:
    """Turn and place the joints of a batch."""
    n, k = len(given.pose), len(packed.parents)
    if given.pose.ndim == 3:
        rotations, features = np.empty((n, k, 3, 3)), np.empty((n, k, packed.n_features))
        kernels.turn(given.pose, packed.n_features, rotations, features)
    else:
        rotations, features = rotations_and_features(model, given.pose)
    coefficients, joint_basis = _coefficients(model, given, packed.joint_basis)
    joints, transforms = np.empty((n, k, 3)), np.empty((n, k, 4, 4))
    skin = np.empty((n, k, 12), packed.basis.dtype)
    kernels.place(
        coefficients, joint_basis, rotations, packed.parents, given.translation,
        joints, transforms, skin,
    )  # fmt: skip
    return Skeleton(coefficients, rotations, features, joints, transforms, skin)


def pose_vertices(packed: Packed, skeleton: Skeleton, translation: Array) -> NDArray[Any]:
    """Return posed vertices (B, V, 3)."""
    n, v = len(skeleton.skin), len(packed.weights)
    rows, features, moved = basis_coefficients(packed, skeleton, translation)
    out = np.empty((n, 3 * v), packed.basis.dtype)
    if n < _TILED_FROM:
        points = rows @ packed.basis[: rows.shape[1]]
        skin_points(packed, points, features, skeleton.skin, moved, out)
        return out.reshape(n, v, 3)
    for k in range(0, n, _SAMPLES):
        part = slice(k, min(k + _SAMPLES, n))
        _pose_many(packed, rows[part], features[part], skeleton.skin[part], moved[part], out[part])
    return out.reshape(n, v, 3)


def _pose_many(
    packed: Packed, rows: NDArray[Any], features: NDArray[Any], skin: NDArray[Any],
    moved: NDArray[Any], out: NDArray[Any],
) -> None:  # fmt: skip
    """Pose samples together, some vertices at a time -> out (B, 3 V)."""
    v, runs = len(packed.weights), packed.runs
    basis = packed.basis[: rows.shape[1]].T
    used = features if len(runs.feature) else features[:, :0]
    columns = np.zeros((rows.shape[1], len(rows) + -len(rows) % kernels.TILE), rows.dtype)
    columns[:, : len(rows)] = rows.T
    maps, driven = kernels.tiled(skin, columns.shape[1]), kernels.tiled(used, columns.shape[1])
    scratch = np.empty((3 * min(v, _VERTICES), columns.shape[1]), rows.dtype)
    for v0 in range(0, v, _VERTICES):
        v1 = min(v0 + _VERTICES, v)
        points = np.matmul(basis[3 * v0 : 3 * v1], columns, out=scratch[: 3 * (v1 - v0)])
        kernels.skin_tiles(
            v0, points, driven, runs.start, runs.feature, runs.offset, runs.values, maps,
            packed.joint_ids, packed.weights, packed.excess, moved, out,
        )  # fmt: skip


def basis_coefficients(
    packed: Packed, skeleton: Skeleton, translation: Array
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return what multiplies the basis' first rows (B, r), pose features (B, K q), shift (B, 3).

    All in the type of the packed bases.
    """
    n, k, q = skeleton.features.shape
    dtype, used = packed.basis.dtype, len(packed.dense) + skeleton.coefficients.shape[1]
    rows, features = np.empty((n, used), dtype), np.empty((n, k * q), dtype)
    moved = np.empty((n, 3), dtype)
    kernels.assemble(
        skeleton.features.reshape(n, k * q), skeleton.coefficients, packed.dense, translation,
        rows, features, moved,
    )  # fmt: skip
    return rows, features, moved


def skin_points(
    packed: Packed, points: NDArray[Any], features: NDArray[Any], skin: NDArray[Any],
    moved: NDArray[Any], out: NDArray[Any],
) -> None:  # fmt: skip
    """Skin rest points (B, 3 V) by the dense bases, sample by sample -> out (B, 3 V)."""
    runs = packed.runs
    kernels.skin_samples(
        points, features, runs.start, runs.feature, runs.offset, runs.values, skin,
        packed.joint_ids, packed.weights, packed.excess, moved, out,
    )  # fmt: skip


def _coefficients(model: BodyModel, given: Arguments, joint_basis: Array) -> tuple[Array, Array]:
    """Return [1, shape, expression] without trailing zeros, and the joint basis cut to it."""
    n, ns, ne = len(given.pose), given.shape.shape[1], given.expression.shape[1]
    at = 1 + model.n_shape
    used = at + ne if ne else 1 + ns
    coefficients = np.zeros((n, used))
    coefficients[:, 0] = 1
    coefficients[:, 1 : 1 + ns] = given.shape
    if ne:
        coefficients[:, at:] = given.expression
    return coefficients, joint_basis[:used]
