"""Evaluation of a batch: checks, then the kernels; single precision unless asked otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from synthgen.models import kernels, skinning
from synthgen.models.arguments import Arguments, checked
from synthgen.models.model import Posed
from synthgen.models.pose_features import rotations_and_features

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel
    from synthgen.models.packed import Packed

Array = NDArray[np.float64]
# Samples of one matrix product: the basis is read once per so many.
_SAMPLES = 256
# From this many samples on, sparse correctives are added to several samples side by side.
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
    drive = driven(packed, skeleton, translation)
    out = np.empty((n, 3 * v), packed.basis.dtype)
    for k in range(0, n, _SAMPLES):
        some = drive if n <= _SAMPLES else Drive(*(a[k : k + _SAMPLES] for a in drive))
        points = rest_points(packed, some, out[k : k + _SAMPLES])
        skin_points(packed, some, points, points)
    return out.reshape(n, v, 3)


class Drive(NamedTuple):
    """What the bases and the points of a batch are multiplied with, in the type of the bases.

    Attributes
    ----------
    rows : (B, r)
        Multiply the basis' first r rows.
    features : (B, K q)
        Pose features, for the sparse correctives.
    maps : (B, K, 12)
        As ``Skeleton.skin``.
    shift : (B, 3)
        Translation.
    """

    rows: NDArray[Any]
    features: NDArray[Any]
    maps: NDArray[Any]
    shift: NDArray[Any]


def driven(packed: Packed, skeleton: Skeleton, translation: Array) -> Drive:
    """Round a posed skeleton for the per-vertex work."""
    n, k, q = skeleton.features.shape
    dtype, used = packed.basis.dtype, len(packed.dense) + skeleton.coefficients.shape[1]
    rows, features = np.empty((n, used), dtype), np.empty((n, k * q), dtype)
    shift = np.empty((n, 3), dtype)
    kernels.assemble(
        skeleton.features.reshape(n, k * q), skeleton.coefficients, packed.dense, translation,
        rows, features, shift,
    )  # fmt: skip
    return Drive(rows, features, skeleton.skin, shift)


def rest_points(packed: Packed, drive: Drive, out: NDArray[Any]) -> NDArray[Any]:
    """Return rest points, correctives included -> out (B, 3 V)."""
    np.matmul(drive.rows, packed.basis[: drive.rows.shape[1]], out=out)
    runs = packed.runs
    if len(runs.vertices):
        correct = skinning.correct_few if len(out) < _TILED_FROM else skinning.correct_many
        correct(
            drive.features, runs.vertices, runs.start, runs.feature, runs.offset, runs.values, out
        )
    return out


def skin_points(packed: Packed, drive: Drive, points: NDArray[Any], out: NDArray[Any]) -> None:
    """Skin rest points (B, 3 V) -> out (B, 3 V), which may be the same."""
    skinning.skin(
        points, drive.maps, packed.joint_ids, packed.weights, packed.excess, drive.shift, out
    )


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
