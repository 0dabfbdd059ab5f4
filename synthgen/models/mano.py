"""Hands in MANO form: arrays, evaluation and a readable float64 reference.

Equations 1-4 of Embodied Hands as the official code computes them: ``v_shaped = T + S beta``,
``J = J_regressor v_shaped`` (before pose correctives), ``v_posed = v_shaped + P vec(R - I)`` over
the 15 finger joints, linear blend skinning, translation last; the root turns about joint 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models.surface import HandSurface

Array = NDArray[np.float64]
Hand = Literal["left", "right"]


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
class ManoModel:
    """One hand in MANO form (any vertex count); arrays as in the files, float64.

    Attributes
    ----------
    name, hand, digest : str
        ``digest`` is the SHA-256 over the arrays.
    v_template : (V, 3) metres
    shapedirs : (V, 3, nb)
    posedirs : (V, 3, 9 (K - 1))
    weights : (V, K)
    J_regressor : (K, V)
    parents : (K,) int64, root -1
    faces : (F, 3) int64, counter-clockwise from outside
    joint_names : tuple of str
    hands_mean : (3 (K - 1),) or None
    hands_components : (n, 3 (K - 1)) or None
    hands_coeffs : (N, n) or None
    fingertip_ids : (5,) int64
        Thumb, index, middle, ring, pinky; ``fingertip_set`` names the choice.
    joint_axes : (K, 3, 3) or None
        Per joint unit rows flexion, abduction, twist, rest frame.
    joint_range : (K, 3, 2) or None
        Radians, lowest and highest angle about each axis.
    finger_radius : (K,) metres
        Typical thickness of flesh around each joint.
    surface : HandSurface
        Hand and arm as they are drawn.
    provenance : str
    """

    name: str
    hand: Hand
    digest: str
    v_template: Array
    shapedirs: Array
    posedirs: Array
    weights: Array
    J_regressor: Array
    parents: NDArray[np.int64]
    faces: NDArray[np.int64]
    joint_names: tuple[str, ...]
    hands_mean: Array | None
    hands_components: Array | None
    hands_coeffs: Array | None
    fingertip_ids: NDArray[np.int64]
    fingertip_set: str
    joint_axes: Array | None
    joint_range: Array | None
    finger_radius: Array
    surface: HandSurface
    provenance: str = field(default="")

    @property
    def family(self) -> str:
        """The form of the model's file: always ``"mano"`` here."""
        return "mano"

    def evaluate(
        self,
        shape: NDArray[Any],
        pose: NDArray[Any],
        translation: NDArray[Any] | None = None,
        expression: None = None,
    ) -> Posed:
        """Evaluate a batch.

        Parameters
        ----------
        shape : (B, nb) float
            Betas, unit variance; fewer than the model's are filled with zeros.
        pose : (B, K, 3) float
            Axis-angle, radians, mean pose included; row 0 is the root, turning about joint 0.
        translation : (B, 3) float or None
            Metres, added last.
        expression : None
            Hands have none.

        Returns
        -------
        Posed

        Raises
        ------
        ShapeError
            If shapes do not fit or a number is not finite.
        """
        betas, theta, moved = self._checked(shape, pose, translation, expression)
        flat = self._flat
        shaped = flat.template + betas.astype(np.float32) @ flat.shape
        joints = np.asarray(
            self._joints_template + np.einsum("kcs,bs->bkc", self._joints_shape, betas)
        )
        rotations = matrix_from_axis_angle(theta)
        feature = (rotations[:, 1:] - np.eye(3)).reshape(len(theta), -1)
        posed = shaped + feature.astype(np.float32) @ flat.pose
        transforms = chain(rotations, joints, self.parents)
        skin = skinning_transforms(transforms, joints)
        vertices = _skin(posed.reshape(len(theta), 3, -1), skin, flat.weights)
        transforms[..., :3, 3] += moved[:, None]
        return Posed(
            vertices=vertices + moved[:, None].astype(np.float32),
            joints=transforms[..., :3, 3].astype(np.float32),
            transforms=transforms,
        )

    def evaluate_reference(
        self,
        shape: NDArray[Any],
        pose: NDArray[Any],
        translation: NDArray[Any] | None = None,
    ) -> tuple[Array, Array]:
        """Evaluate in float64 with plain loops; vertices (B, V, 3) and joints (B, K, 3).

        The readable truth that :meth:`evaluate` is tested against; same arguments.
        """
        betas, theta, moved = self._checked(shape, pose, translation, None)
        results = [
            self._reference_one(b, t, m) for b, t, m in zip(betas, theta, moved, strict=True)
        ]
        return np.array([v for v, _ in results]), np.array([j for _, j in results])

    def _reference_one(self, beta: Array, theta: Array, moved: Array) -> tuple[Array, Array]:
        shaped = self.v_template + self.shapedirs @ beta
        joints = self.J_regressor @ shaped
        rotation = [matrix_from_axis_angle(row) for row in theta]
        feature = np.concatenate([(r - np.eye(3)).ravel() for r in rotation[1:]])
        posed = shaped + self.posedirs @ feature
        turn, place = [rotation[0]], [joints[0]]
        for k in range(1, len(rotation)):
            p = self.parents[k]
            turn.append(turn[p] @ rotation[k])
            place.append(place[p] + turn[p] @ (joints[k] - joints[p]))
        vertices = np.zeros_like(posed)
        for k, (r, t) in enumerate(zip(turn, place, strict=True)):
            vertices += self.weights[:, k, None] * ((posed - joints[k]) @ r.T + t)
        return vertices + moved, np.array(place) + moved

    def shaped(self, shape: NDArray[Any]) -> tuple[Array, Array]:
        """Return rest-pose vertices (V, 3) and joints (K, 3) of betas (nb,), float64."""
        vertices = self.v_template + self.shapedirs @ np.asarray(shape, dtype=np.float64)
        return vertices, self.J_regressor @ vertices

    def _checked(
        self, shape: Any, pose: Any, translation: Any, expression: Any
    ) -> tuple[Array, Array, Array]:
        betas, theta = np.asarray(shape, np.float64), np.asarray(pose, np.float64)
        n, nb, k = len(theta), self.shapedirs.shape[2], len(self.parents)
        moved = np.zeros((n, 3)) if translation is None else np.asarray(translation, np.float64)
        if expression is not None:
            raise ShapeError(f"model {self.name!r} is a hand and has no expression; pass None")
        if theta.shape != (n, k, 3):
            raise ShapeError(f"pose has shape {theta.shape}; expected (B, {k}, 3) axis-angle")
        if betas.ndim != 2 or len(betas) != n or betas.shape[1] > nb:
            raise ShapeError(f"shape is {betas.shape}; expected ({n}, nb) with nb <= {nb}")
        if moved.shape != (n, 3):
            raise ShapeError(f"translation has shape {moved.shape}; expected ({n}, 3)")
        for what, values in (("shape", betas), ("pose", theta), ("translation", moved)):
            if not np.isfinite(values).all():
                raise ShapeError(f"{what} holds {values[~np.isfinite(values)][0]}; must be finite")
        return np.pad(betas, ((0, 0), (0, nb - betas.shape[1]))), theta, moved

    @cached_property
    def _flat(self) -> _Flat:
        v = len(self.v_template)
        return _Flat(
            template=self.v_template.T.ravel().astype(np.float32),
            shape=self.shapedirs.transpose(2, 1, 0).reshape(-1, 3 * v).astype(np.float32),
            pose=self.posedirs.transpose(2, 1, 0).reshape(-1, 3 * v).astype(np.float32),
            weights=self.weights.astype(np.float32),
        )

    @cached_property
    def _joints_template(self) -> Array:
        return self.J_regressor @ self.v_template

    @cached_property
    def _joints_shape(self) -> Array:
        return np.asarray(np.einsum("kv,vcs->kcs", self.J_regressor, self.shapedirs))


@dataclass(frozen=True, eq=False)
class _Flat:
    """Single-precision planes x|y|z of the bases, ready for matrix products."""

    template: NDArray[np.float32]
    shape: NDArray[np.float32]
    pose: NDArray[np.float32]
    weights: NDArray[np.float32]


def chain(rotations: Array, joints: Array, parents: NDArray[np.int64]) -> Array:
    """Compose joint placements (B, K, 4, 4) from local rotations and rest joints (B, K, 3)."""
    n, k = joints.shape[:2]
    G = np.zeros((n, k, 4, 4))
    G[..., 3, 3] = 1
    for j, p in enumerate(parents):
        if p < 0:
            G[:, j, :3, :3], G[:, j, :3, 3] = rotations[:, j], joints[:, j]
            continue
        G[:, j, :3, :3] = G[:, p, :3, :3] @ rotations[:, j]
        offset = (joints[:, j] - joints[:, p])[..., None]
        G[:, j, :3, 3] = G[:, p, :3, 3] + (G[:, p, :3, :3] @ offset)[..., 0]
    return G


def skinning_transforms(transforms: Array, joints: Array) -> Array:
    """Return (B, K, 3, 4) maps from rest-pose points to posed points."""
    A = transforms[..., :3, :].copy()
    A[..., 3] -= (A[..., :3] @ joints[..., None])[..., 0]
    return A


def _skin(
    points: NDArray[np.float32], skin: Array, weights: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Blend: points (B, 3, V) planes, skin (B, K, 3, 4), weights (V, K) -> (B, V, 3)."""
    n, k = skin.shape[:2]
    blended = (weights @ skin.reshape(n, k, 12).astype(np.float32)).reshape(n, -1, 3, 4)
    moved = np.einsum("bvij,bjv->bvi", blended[..., :3], points) + blended[..., 3]
    return np.asarray(moved, dtype=np.float32)
