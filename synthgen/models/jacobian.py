"""Analytic derivatives of vertices and joints by every parameter, float64."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.models import jacobian_kernels as kernels
from synthgen.models.arguments import Arguments, checked
from synthgen.models.evaluation import pose_skeleton
from synthgen.models.pose_tangents import tangents
from synthgen.models.row_bases import in_lanes

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel
    from synthgen.models.row_bases import RowBases

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives at one sample, or at a batch with a leading axis B everywhere.

    Columns are shape (as many as were given), pose, translation (3), expression (as many as were
    given). A pose column is one number of the pose as it was given: 3 K of axis-angle, P of a
    constrained tree; of rotation matrices, a rotation vector multiplied from the left, at zero.

    Attributes
    ----------
    values : (m, 3, D) float64
        d vertex / d parameter; also ``numpy.asarray(jacobian)``.
    vertices : (m, 3) float64, metres
        The vertices themselves, which come for free.
    joint_values : (K, 3, D) float64
    joints : (K, 3) float64, metres
    n_shape, n_pose, n_expression : int
        Number of columns of each kind.
    """

    values: Array
    vertices: Array
    joint_values: Array
    joints: Array
    n_shape: int
    n_pose: int
    n_expression: int

    @property
    def shape(self) -> Array:
        """Columns of the shape, a view (m, 3, n_shape)."""
        return self.values[..., : self.n_shape]

    @property
    def pose(self) -> Array:
        """Columns of the pose, a view (m, 3, n_pose)."""
        return self.values[..., self.n_shape : self.n_shape + self.n_pose]

    @property
    def translation(self) -> Array:
        """Columns of the translation, a view (m, 3, 3): the identity."""
        at = self.n_shape + self.n_pose
        return self.values[..., at : at + 3]

    @property
    def expression(self) -> Array:
        """Columns of the expression, a view (m, 3, n_expression)."""
        return self.values[..., self.n_shape + self.n_pose + 3 :]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)


def jacobian(
    model: BodyModel,
    shape: NDArray[Any],
    pose: NDArray[Any],
    translation: NDArray[Any] | None = None,
    expression: NDArray[Any] | None = None,
    *,
    rows: NDArray[Any] | None = None,
) -> Jacobian:
    """Differentiate vertices and joints by all parameters.

    Parameters
    ----------
    model : BodyModel
    shape : (nb,) or (B, nb) float
    pose : (K, 3), (K, 3, 3) or (P,) float, or with a leading B
    translation : (3,) or (B, 3) float or None
    expression : (ne,) or (B, ne) float or None
    rows : (m,) int or None
        Vertices wanted (repeats allowed); None: all. Cost grows with their number.

    Returns
    -------
    Jacobian
        Without the leading B if ``shape`` has one axis.

    Raises
    ------
    ShapeError
        If shapes do not fit, a number is not finite or a row does not exist.
    """
    single = np.ndim(shape) == 1
    given = (shape, pose, translation, expression)
    args = checked(model, *(_batched(a) if single else a for a in given))
    wanted = _rows(rows, len(model.v_template))
    parts = [_one(model, args, b, wanted) for b in range(len(args.pose))]
    if single:
        values, vertices, joint_values, joints = parts[0]
    else:
        stacked = zip(*parts, strict=True)
        values, vertices, joint_values, joints = (np.stack(part) for part in stacked)
    ns, ne = args.shape.shape[1], args.expression.shape[1]
    n_pose = values.shape[-1] - ns - ne - 3
    return Jacobian(values, vertices, joint_values, joints, ns, n_pose, ne)


def _one(
    model: BodyModel, args: Arguments, b: int, rows: NDArray[np.int64]
) -> tuple[Array, Array, Array, Array]:
    bases: RowBases = model.row_bases
    own = slice(b, b + 1)
    zero = np.zeros((1, 3))
    args = Arguments(args.shape[own], args.pose[own], args.translation[own], args.expression[own])
    skeleton = pose_skeleton(
        model, Arguments(args.shape, args.pose, zero, args.expression), model.packed
    )
    transforms, rotations = skeleton.transforms[0], skeleton.rotations[0]
    turned = tangents(model, args.pose[0], rotations, bases.n_features)
    axes = np.empty_like(turned.omega)
    kernels.world_axes(turned.omega, transforms, bases.parents, axes)
    betas, psi = args.shape[0], args.expression[0]
    at = 1 + model.n_shape
    by_shape = _by_coefficients(bases, transforms, bases.joint_basis[1 : 1 + len(betas)])
    by_expression = _by_coefficients(bases, transforms, bases.joint_basis[at : at + len(psi)])
    n_pose = 3 * len(transforms) if args.pose.ndim > 2 else args.pose.shape[1]
    d = len(betas) + n_pose + 3 + len(psi)
    values, vertices = np.zeros((len(rows), 3, d)), np.empty((len(rows), 3))
    kernels.vertex_rows(
        rows, bases.template, bases.directions, bases.expressions, bases.correctives, bases.reach,
        bases.first, bases.joint_ids, bases.weights, bases.parents, betas, psi,
        _numbers(turned.feature[bases.first :], skeleton.features[0, bases.first :]),
        axes, turned.column, transforms, skeleton.joints[0], by_shape[1], by_expression[1],
        vertices, values,
    )  # fmt: skip
    of_joints = np.zeros((len(transforms), 3, d))
    kernels.joint_rows(transforms, bases.parents, axes, turned.column, len(betas), of_joints)
    of_joints[..., : len(betas)] = by_shape[0]
    of_joints[..., d - len(psi) :] = by_expression[0]
    of_joints[..., d - len(psi) - 3 : d - len(psi)] = np.eye(3)
    return (
        values,
        vertices + args.translation,
        of_joints,
        transforms[:, :3, 3] + args.translation,
    )


def _numbers(by_number: Array, features: Array) -> NDArray[np.float32]:
    """Lay out (J, 3, q) and (J, q) in blocks of joints: (n, q, 4 LANES), features last."""
    joined = np.concatenate([by_number, features[:, None]], axis=1, dtype=np.float32)
    blocks = in_lanes(np.ascontiguousarray(joined.transpose(1, 2, 0)))
    n, q = blocks.shape[1], features.shape[1]
    lanes = blocks.reshape(4, n, q, kernels.LANES).transpose(1, 2, 0, 3)
    return np.ascontiguousarray(lanes).reshape(n, q, 4 * kernels.LANES)


def _by_coefficients(bases: RowBases, transforms: Array, joint_basis: Array) -> tuple[Array, Array]:
    """Differentiate posed joints and the maps' translations by coefficients, (K, 3, n) each."""
    n, k = joint_basis.shape[:2]
    moved, offset = np.empty((k, 3, n)), np.empty((k, 3, n))
    kernels.joints_by_coefficients(joint_basis, transforms, bases.parents, moved, offset)
    return moved, offset


def _batched(value: Any) -> Any:
    return None if value is None else np.asarray(value)[None]


def _rows(rows: Any, n: int) -> NDArray[np.int64]:
    if rows is None:
        return np.arange(n)
    wanted = np.asarray(rows)
    if wanted.ndim != 1 or wanted.dtype.kind not in "iu":
        raise ShapeError(f"rows is {wanted.dtype}{wanted.shape}; expected (m,) vertex numbers")
    if wanted.size and (wanted.min() < 0 or wanted.max() >= n):
        raise ShapeError(
            f"rows holds {int(wanted.min())}..{int(wanted.max())}; expected 0..{n - 1}"
        )
    return wanted.astype(np.int64)
