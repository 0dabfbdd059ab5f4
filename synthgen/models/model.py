"""The one form in which every model is held: MANO, SMPL+H, SUPR and STAR.

A :class:`BodyModel` is plain data plus evaluation. Families differ in what their pose correctives
see and how joints are regressed, nothing else:

======  ==================================  =======================  ==========================
family  pose feature                        ``posedirs`` columns     joints
======  ==================================  =======================  ==========================
mano    R - I, row-major, without the root  9 (K - 1)                ``J_regressor`` (K, V)
smplh   as mano                             9 (K - 1)                ``J_regressor`` (K, V)
supr    quaternion minus identity (x y z w) 4 K, or 4 (K - 1)        affine (3K, 3V + 1)
star    as supr without the root, + beta 1  4 (K - 1) + 1            ``J_regressor`` (K, V)
======  ==================================  =======================  ==========================

Everywhere: ``v_shaped = v_template + shapedirs beta + exprdirs psi``, joints from ``v_shaped``
(before correctives), linear blend skinning, translation last; the root turns about joint 0, which
is not the origin (see :mod:`synthgen.models.recentre`).

Joint names: fingers of a hand model are ``index1`` .. ``thumb3``; on a body they carry their side,
``left_index1`` .. ``right_thumb3``. Functions find joints by these names, never by position.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.models.constrained import Constrained, ConstrainedTree

if TYPE_CHECKING:
    from synthgen.models.jacobian import Jacobian
    from synthgen.models.packed import Packed
    from synthgen.models.row_bases import RowBases

Array = NDArray[np.float64]
Hand = Literal["left", "right"]
Family = Literal["mano", "smplh", "supr", "star"]


@dataclass(frozen=True, eq=False)
class Posed:
    """Result of evaluating a model on a batch.

    Attributes
    ----------
    vertices : (B, V, 3) float32, metres
    joints : (B, K, 3) float32, metres
    transforms : (B, K, 4, 4) float64
        World placement of each joint's frame; maps rest-pose offsets from the joint.
    """

    vertices: NDArray[np.float32]
    joints: NDArray[np.float32]
    transforms: Array


@dataclass(frozen=True, eq=False)
class HandSpace:
    """Pose space of one hand's 15 finger joints, as in the files.

    Attributes
    ----------
    mean : (45,) radians
    components : (n, 45)
        Rows, close to orthonormal but not exactly so: invert by least squares.
    coeffs : (N, n) or None
        Coefficients of the registered poses.
    """

    mean: Array
    components: Array
    coeffs: Array | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class BodyModel:
    """A model's arrays as in its file, float64, and its evaluation.

    Attributes
    ----------
    name : str
        Its name or path.
    family : "mano", "smplh", "supr" or "star"
    digest : str
        SHA-256 over the arrays.
    hand : "left", "right" or None
        Side of a hand model; None for bodies and other parts.
    v_template : (V, 3) metres
    shapedirs : (V, 3, nb)
    exprdirs : (V, 3, ne) or None
        SUPR expressions.
    posedirs : (V, 3, n_features)
    weights : (V, K)
    J_regressor : (K, V), SUPR (3K, 3V + 1) affine
    joint_basis : (1 + nb + ne, K, 3) or None
        Rest joints as an affine function of [1, shape, expression], for parts whose joints depend
        on vertices that were cut away; None: folded from ``J_regressor``.
    parents : (K,) int64, root -1, parents before children
    faces : (F, 3) int64, counter-clockwise from outside
    joint_names : tuple of str
    hands_mean : (45,), hands_components : (n, 45), hands_coeffs : (N, n), or None
        Pose space of a hand model, as in its file.
    hands_left, hands_right : HandSpace or None
        Pose spaces of a body's hands.
    fingertip_ids : (5,) int64, bodies (10,), else (0,)
        Thumb, index, middle, ring, pinky (bodies: left, then right); ``fingertip_set`` names the
        choice.
    landmark_ids : (11,) int64, else (0,)
        Vertices of a whole body's nose, eyes, ears, toes and heels, in the order of
        ``joints.LANDMARK_NAMES``.
    vert_sym_idxs : (V,) int64 or None
        Mirror image of each vertex, where the file says so.
    part_ids : mapping of str to (n,) int64
        Vertices of "head", "left_hand", ..., where the file names them (``part_*``).
    axis_meta : ConstrainedTree or None
        Given: the pose is (B, P) angles.
    constrained : "official" or "consistent"
        How ``axis_meta`` is read (:mod:`synthgen.models.constrained`); change it with
        ``dataclasses.replace(model, constrained=...)``.
    provenance : str
    warnings : tuple of str
        What a user should know about the file.
    """

    name: str
    family: Family
    digest: str
    v_template: Array
    shapedirs: Array
    posedirs: Array
    weights: Array
    J_regressor: Array
    parents: NDArray[np.int64]
    faces: NDArray[np.int64]
    joint_names: tuple[str, ...]
    hand: Hand | None = None
    exprdirs: Array | None = None
    joint_basis: Array | None = None
    hands_mean: Array | None = None
    hands_components: Array | None = None
    hands_coeffs: Array | None = None
    hands_left: HandSpace | None = None
    hands_right: HandSpace | None = None
    fingertip_ids: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    fingertip_set: str = ""
    landmark_ids: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    vert_sym_idxs: NDArray[np.int64] | None = None
    part_ids: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    axis_meta: ConstrainedTree | None = None
    constrained: Constrained = "official"
    provenance: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def n_shape(self) -> int:
        """Shape coefficients (nb)."""
        return int(self.shapedirs.shape[2])

    @property
    def n_expression(self) -> int:
        """Expression coefficients (ne), 0 where the model has none."""
        return 0 if self.exprdirs is None else int(self.exprdirs.shape[2])

    @property
    def n_pose(self) -> int:
        """Numbers in a pose: 3 K, or P of a constrained tree."""
        return 3 * len(self.parents) if self.axis_meta is None else self.axis_meta.n_pose

    def hand_space(self, side: Hand) -> HandSpace | None:
        """Pose space of one hand, of hand models and bodies alike."""
        if self.hand is None:
            return self.hands_left if side == "left" else self.hands_right
        if self.hand != side or self.hands_mean is None or self.hands_components is None:
            return None
        return HandSpace(self.hands_mean, self.hands_components, self.hands_coeffs)

    def evaluate(
        self,
        shape: NDArray[Any],
        pose: NDArray[Any],
        translation: NDArray[Any] | None = None,
        expression: NDArray[Any] | None = None,
        *,
        flat_hand_mean: bool | None = None,
    ) -> Posed:
        """Evaluate a batch in single precision.

        Parameters
        ----------
        shape : (B, nb) float
            Betas, unit variance; fewer than the model's are filled with zeros.
        pose : (B, K, 3), (B, K, 3, 3), (B, P) or (B, D) float
            Axis-angle, radians, mean pose included, row 0 the root, turning about joint 0; or
            rotation matrices; or the angles of a constrained tree; or, where ``flat_hand_mean``
            is given, axis-angle of all joints but the fingers followed by PCA coefficients of
            the hand (bodies: left, then right; SMPL+H with 6 each: 66 + 12 = 78 numbers).
        translation : (B, 3) float or None
            Metres, added last.
        expression : (B, ne) float or None
            SUPR only; fewer than the model's are filled with zeros.
        flat_hand_mean : bool or None
            With PCA coefficients: True if zero coefficients mean a flat hand, False if they mean
            ``hands_mean``. None for every other kind of pose.

        Returns
        -------
        Posed

        Raises
        ------
        ShapeError
            If shapes do not fit or a number is not finite.
        """
        from synthgen.models.evaluation import evaluate

        return evaluate(self, shape, pose, translation, expression, flat_hand_mean)

    def evaluate_joints(
        self,
        shape: NDArray[Any],
        pose: NDArray[Any],
        translation: NDArray[Any] | None = None,
        expression: NDArray[Any] | None = None,
        *,
        flat_hand_mean: bool | None = None,
    ) -> NDArray[np.float32]:
        """Evaluate joints (B, K, 3) alone, without the mesh; arguments as :meth:`evaluate`."""
        from synthgen.models.evaluation import evaluate_joints

        return evaluate_joints(self, shape, pose, translation, expression, flat_hand_mean)

    def evaluate_reference(
        self,
        shape: NDArray[Any],
        pose: NDArray[Any],
        translation: NDArray[Any] | None = None,
        expression: NDArray[Any] | None = None,
    ) -> tuple[Array, Array]:
        """Evaluate in float64 with plain loops; vertices (B, V, 3) and joints (B, K, 3).

        The readable truth that :meth:`evaluate` is tested against; same arguments.
        """
        from synthgen.models.reference import evaluate_reference

        return evaluate_reference(self, shape, pose, translation, expression)

    def jacobian(
        self,
        shape: NDArray[Any],
        pose: NDArray[Any],
        translation: NDArray[Any] | None = None,
        expression: NDArray[Any] | None = None,
        *,
        rows: NDArray[Any] | None = None,
    ) -> Jacobian:
        """Differentiate vertices by all parameters; see :func:`synthgen.models.jacobian.jacobian`.

        Parameters
        ----------
        shape, pose, translation, expression
            One sample, (nb,), (K, 3), (3,), (ne,), or a batch as :meth:`evaluate`.
        rows : (m,) int or None
            Vertices wanted; None: all.
        """
        from synthgen.models.jacobian import jacobian

        return jacobian(self, shape, pose, translation, expression, rows=rows)

    def shaped(
        self, shape: NDArray[Any], expression: NDArray[Any] | None = None
    ) -> tuple[Array, Array]:
        """Return rest-pose vertices and joints, float64, metres.

        Parameters
        ----------
        shape : (n,) float
            Betas; fewer than the model's nb are filled with zeros.
        expression : (m,) float or None
            As ``shape``, of models that have any.

        Returns
        -------
        vertices : (V, 3), joints : (K, 3)

        Raises
        ------
        ShapeError
            If there are more numbers than components, or one is not finite.
        """
        from synthgen.models.arguments import checked_row
        from synthgen.models.reference import rest

        betas = checked_row(shape, self.n_shape, "shape", self.name)
        psi: Any = [] if expression is None else expression
        return rest(self, betas, checked_row(psi, self.n_expression, "expression", self.name))

    @cached_property
    def packed(self) -> Packed:
        """Single-precision planes of the bases, made on first use (for the kernels)."""
        from synthgen.models.packed import pack

        return pack(self, np.float32)

    @cached_property
    def packed_double(self) -> Packed:
        """Double-precision planes of the bases, made on first use (for exact derivatives)."""
        from synthgen.models.packed import pack

        return pack(self, np.float64)

    @cached_property
    def row_bases(self) -> RowBases:
        """Bases by vertex, made on first use (for the Jacobian)."""
        from synthgen.models.row_bases import row_bases

        return row_bases(self)
