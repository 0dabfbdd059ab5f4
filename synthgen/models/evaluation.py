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
# Samples in one matrix product. A basis beyond the caches is read once a chunk, so that chunks
# are large; otherwise they are small, because fresh memory costs more than arithmetic.
_CHUNK, _SMALL_CHUNK, _CACHED_BYTES = 256, 64, 4 * 2**20
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
    n, v, dtype = len(skeleton.skin), len(packed.weights), packed.basis.dtype
    features, coefficients = basis_coefficients(packed, skeleton)
    moved, out = translation.astype(dtype), np.empty((n, v, 3), dtype)
    size = min(n, _SMALL_CHUNK if packed.basis.nbytes < _CACHED_BYTES else _CHUNK)
    scratch = np.empty(3 * v * (size + kernels.TILE), dtype)
    runs = packed.runs
    for part in (slice(k, min(k + size, n)) for k in range(0, n, max(size, 1))):
        skinned, points = _rest_points(packed, coefficients[part], scratch)
        skinned(
            points, features[part], runs.start, runs.feature, runs.offset, runs.values,
            skeleton.skin[part], packed.joint_ids, packed.weights, packed.excess, moved[part],
            out[part].reshape(-1, 3 * v),
        )  # fmt: skip
    return out


def basis_coefficients(packed: Packed, skeleton: Skeleton) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return pose features (B, K q), and what multiplies the basis' first rows (B, r)."""
    n = len(skeleton.skin)
    features = skeleton.features.reshape(n, -1 if n else 1).astype(packed.basis.dtype)
    rows = [features[:, packed.dense] if n else features, skeleton.coefficients]
    return features, np.concatenate(rows, axis=1, dtype=packed.basis.dtype)


def _rest_points(
    packed: Packed, coefficients: NDArray[Any], scratch: NDArray[Any]
) -> tuple[Any, NDArray[Any]]:
    """Return the skinning kernel for a chunk, and rest points by its dense bases."""
    n = len(coefficients)
    basis = packed.basis[: coefficients.shape[1]]
    if n < _TILED_FROM:
        return kernels.skin_samples, coefficients @ basis
    filled = np.pad(coefficients, ((0, -n % kernels.TILE), (0, 0)))
    points = scratch[: basis.shape[1] * len(filled)].reshape(basis.shape[1], len(filled))
    return kernels.skin_tiles, np.matmul(basis.T, filled.T, out=points)


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
