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
CHUNK = 64


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
    given = checked(model, shape, pose, translation, expression, flat)
    packed = model.packed
    skeleton = pose_skeleton(model, given, packed)
    vertices, _ = pose_vertices(packed, skeleton, given.translation)
    return Posed(
        vertices=vertices,
        joints=skeleton.transforms[..., :3, 3].astype(np.float32),
        transforms=skeleton.transforms,
    )


def evaluate_joints(
    model: BodyModel, shape: Any, pose: Any, translation: Any, expression: Any, flat: bool | None
) -> NDArray[np.float32]:
    """Evaluate joints alone; see ``BodyModel.evaluate_joints``."""
    given = checked(model, shape, pose, translation, expression, flat)
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


def pose_vertices(
    packed: Packed, skeleton: Skeleton, translation: Array
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return posed vertices (B, V, 3) and the corrected rest planes (b, 3, V) of the last chunk.

    Batches go through in chunks, so that the planes of one stay in the cache.
    """
    n, v, dtype = len(skeleton.skin), len(packed.weights), packed.basis.dtype
    features = skeleton.features.reshape(n, skeleton.features[0].size if n else 0).astype(dtype)
    rows = [features[:, packed.dense], skeleton.coefficients.astype(dtype)]
    coefficients = np.concatenate(rows, axis=1)
    basis, moved = packed.basis[: coefficients.shape[1]], translation.astype(dtype)
    planes, vertices = np.empty((min(n, CHUNK), 3, v), dtype), np.empty((n, v, 3), dtype)
    runs = packed.runs
    for part in (slice(k, min(k + CHUNK, n)) for k in range(0, n, CHUNK)):
        planes = planes[: part.stop - part.start]
        np.matmul(coefficients[part], basis, out=planes.reshape(len(planes), 3 * v))
        kernels.skin_vertices(
            planes, features[part], runs.start, runs.feature, runs.offset, runs.values,
            skeleton.skin[part], packed.joint_ids, packed.weights, packed.excess, moved[part],
            vertices[part],
        )  # fmt: skip
    return vertices, planes


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
