"""Vector-Jacobian product: gradients by vertices and joints, pulled back to the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.models import vjp_kernels
from synthgen.models.arguments import Arguments, checked
from synthgen.models.evaluation import Skeleton, driven, pose_skeleton, rest_points, skin_points
from synthgen.models.pose_tangents import of_vectors, tangents

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel
    from synthgen.models.packed import Packed

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Forward:
    """A forward pass, with what its pull-back needs.

    Attributes
    ----------
    vertices : (B, V, 3), joints : (B, K, 3)
        Metres; vertices in the type of the packed bases, joints float64.
    points : (B, 3 V)
        Rest points, correctives included.
    """

    model: BodyModel
    packed: Packed
    given: Arguments
    skeleton: Skeleton
    points: NDArray[Any]
    vertices: NDArray[Any]
    joints: Array

    def pull(self, on_vertices: Any = None, on_joints: Any = None) -> Gradient:
        """Pull gradients by vertices (B, V, 3) and joints (B, K, 3) back; None means zero.

        Raises
        ------
        ShapeError
            If a gradient has another shape than what it belongs to.
        """
        force = _like(self.vertices, on_vertices, "on_vertices")
        push = np.ascontiguousarray(_like(self.joints, on_joints, "on_joints"), np.float64)
        return _pull(self, force, push)


@dataclass(frozen=True, eq=False)
class Gradient:
    """Gradients of one number, float64, in the shapes of the parameters.

    Attributes
    ----------
    shape : (B, n), pose : (B, K, 3) or (B, P), translation : (B, 3), expression : (B, m)
    """

    shape: Array
    pose: Array
    translation: Array
    expression: Array


def forward(
    model: BodyModel,
    shape: Any,
    pose: Any,
    translation: Any = None,
    expression: Any = None,
    *,
    dtype: type[np.float32] | type[np.float64] = np.float32,
) -> Forward:
    """Evaluate a batch and keep what :meth:`Forward.pull` needs.

    Arguments as ``BodyModel.evaluate``, without PCA coefficients; of rotation matrices, gradients
    (B, K, 3) are by a rotation vector multiplied from the left, at zero. ``dtype`` is the
    precision of the per-vertex work.

    Raises
    ------
    ShapeError
        If shapes do not fit, a number is not finite or there is no sample.
    """
    given = checked(model, shape, pose, translation, expression)
    if not len(given.pose):
        raise ShapeError("a batch of no samples has no gradient; pass at least one")
    packed = model.packed if dtype == np.float32 else model.packed_double
    skeleton = pose_skeleton(model, given, packed)
    drive = driven(packed, skeleton, given.translation)
    points = np.empty((len(given.pose), packed.basis.shape[1]), packed.basis.dtype)
    out = np.empty_like(points)
    skin_points(packed, drive, rest_points(packed, drive, points), out)
    vertices = out.reshape(len(out), len(packed.weights), 3)
    joints = np.ascontiguousarray(skeleton.transforms[..., :3, 3])
    return Forward(model, packed, given, skeleton, points, vertices, joints)


def _pull(state: Forward, force: NDArray[Any], push: Array) -> Gradient:
    packed, skeleton, given = state.packed, state.skeleton, state.given
    n, k = skeleton.joints.shape[:2]
    q, runs = packed.n_features, packed.runs
    flat = np.ascontiguousarray(force, packed.basis.dtype).reshape(n, -1)
    on_maps, on_points = np.zeros_like(skeleton.skin), np.empty_like(flat)
    on_features = np.zeros((n, k * q), flat.dtype)
    vjp_kernels.pull_vertices(
        flat, state.points, runs.start, runs.feature, runs.offset, runs.values, skeleton.skin,
        packed.joint_ids, packed.weights, packed.excess, on_maps, on_points, on_features,
    )  # fmt: skip
    used = len(packed.dense) + skeleton.coefficients.shape[1]
    if n == 1:
        on_rows = np.empty((1, used), flat.dtype)
        vjp_kernels.pull_rows(packed.basis[:used], on_points[0], on_rows[0])
    else:
        on_rows = on_points @ packed.basis[:used].T
    on_features[:, packed.dense] += on_rows[:, : len(packed.dense)]
    omega, feature, column = _tangents(state)
    on_pose, on_rest = np.zeros((n, int(column.max()) + 1)), np.zeros((n, k, 3))
    vjp_kernels.pull_skeleton(
        on_maps, on_features, push, skeleton.transforms, skeleton.joints, packed.parents,
        omega, feature, column, on_pose, on_rest,
    )  # fmt: skip
    basis = packed.joint_basis[: skeleton.coefficients.shape[1]]
    on_coefficients = on_rows[:, len(packed.dense) :] + on_rest.reshape(n, -1) @ basis.T
    at, (ns, ne) = 1 + state.model.n_shape, (given.shape.shape[1], given.expression.shape[1])
    return Gradient(
        shape=on_coefficients[:, 1 : 1 + ns],
        pose=on_pose if given.pose.ndim == 2 else on_pose.reshape(n, k, 3),
        translation=np.einsum("bvc->bc", flat.reshape(n, -1, 3), dtype=np.float64)
        + push.sum(axis=1),
        expression=on_coefficients[:, at : at + ne],
    )


def _tangents(state: Forward) -> tuple[Array, Array, NDArray[np.int64]]:
    """Tangents of a batch: omega (B, K, 3, 3), feature (B, K, 3, q), column (K, 3)."""
    pose, rotations, q = state.given.pose, state.skeleton.rotations, state.packed.n_features
    n, k = rotations.shape[:2]
    if pose.ndim == 3:
        omega, feature = np.empty((n * k, 3, 3)), np.empty((n * k, 3, q))
        of_vectors(pose.reshape(-1, 3), rotations.reshape(-1, 3, 3), omega, feature)
        column = np.arange(3 * k).reshape(k, 3)
        return omega.reshape(n, k, 3, 3), feature.reshape(n, k, 3, q), column
    each = [tangents(state.model, p, r, q) for p, r in zip(pose, rotations, strict=True)]
    return np.array([t.omega for t in each]), np.array([t.feature for t in each]), each[0].column


def _like(value: NDArray[Any], gradient: Any, what: str) -> NDArray[Any]:
    if gradient is None:
        return np.zeros_like(value)
    given = np.asarray(gradient)
    if given.shape != value.shape:
        raise ShapeError(f"{what} is {given.shape}; expected {value.shape}")
    return given
