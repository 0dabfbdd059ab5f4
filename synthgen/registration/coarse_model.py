"""A thinned, single-precision hand for many starts at once.

A few hundred vertices spread over the skin, no pose correctives (their millimetres do not matter
here), fingers in principal components of the prior, in standard deviations. The rotation is a
matrix, turned from the left, so that no direction is special.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from synthgen.models import BodyModel
from synthgen.models.packed import fold_joints
from synthgen.registration.prior import HandPrior
from synthgen.registration.surface import Surface, left_jacobian, surface_of

Single = NDArray[np.float32]
Array = NDArray[np.float64]
VERTICES, COMPONENTS = 390, 30


@dataclass(frozen=True, eq=False)
class Starts:
    """S hypotheses.

    Attributes
    ----------
    rotation : (S, 3, 3) float32
    translation : (S, 3) float32, metres
    coefficients : (S, c) float32, standard deviations
    shape : (S, nb) float32
    """

    rotation: Single
    translation: Single
    coefficients: Single
    shape: Single

    def __len__(self) -> int:
        return len(self.rotation)

    def take(self, which: Any) -> Starts:
        """Return some of them."""
        return Starts(self.rotation[which], self.translation[which], self.coefficients[which],
                      self.shape[which])  # fmt: skip


def join(several: list[Starts]) -> Starts:
    """Concatenate hypotheses."""
    return Starts(
        np.concatenate([s.rotation for s in several]),
        np.concatenate([s.translation for s in several]),
        np.concatenate([s.coefficients for s in several]),
        np.concatenate([s.shape for s in several]),
    )


@dataclass(frozen=True, eq=False)
class PlacedBatch:
    """Vertices and normals (S, V, 3) of hypotheses, and what their derivatives need."""

    vertices: Single
    normals: Single
    rest: Single
    frames: Single
    joints: Single
    shift: Single
    blend: Single
    left: Single


class CoarseModel:
    """The thinned hand; see the module's text."""

    def __init__(self, surface: Surface, prior: HandPrior) -> None:
        model = surface.model
        self.surface, self.prior = surface, prior
        self.ids = spread(model.v_template, VERTICES)
        self.rim = surface.rim[self.ids]
        self.template = model.v_template[self.ids].astype(np.float32)
        normals = vertex_normals(model.v_template, surface.faces)
        self.rest_normals = normals[self.ids].astype(np.float32)
        self.weights = np.ascontiguousarray(model.weights[self.ids], dtype=np.float32)
        self.shapedirs = np.ascontiguousarray(model.shapedirs[self.ids], dtype=np.float32)
        basis = fold_joints(model).astype(np.float32)
        self.joint_template = basis[0]
        self.joint_shapes = np.ascontiguousarray(basis[1:].transpose(1, 2, 0))
        self.parents = model.parents
        self.mean = prior.mean.astype(np.float32)
        scaled = prior.components[:COMPONENTS] * prior.sd[:COMPONENTS, None]
        self.basis = scaled.astype(np.float32)
        below = np.zeros((surface.n_joints, surface.n_joints), dtype=np.float32)
        for k in range(surface.n_joints):
            up = k
            while up >= 0:
                below[up, k] = 1
                up = int(model.parents[up])
        self.carried = self.weights @ below.T
        self.n_shape = model.n_shape
        self.n = 6 + COMPONENTS + self.n_shape

    def place(self, starts: Starts) -> PlacedBatch:
        """Pose, place and skin every hypothesis."""
        s, k = len(starts), len(self.parents)
        theta = (self.mean + starts.coefficients @ self.basis).reshape(-1, 3)
        local = matrix_from_axis_angle(theta).astype(np.float32).reshape(s, k - 1, 3, 3)
        left = left_jacobian(theta).astype(np.float32).reshape(s, k - 1, 3, 3)
        rest_joints = self.joint_template + np.tensordot(starts.shape, self.joint_shapes, (1, 2))
        rest = self.template + np.tensordot(starts.shape, self.shapedirs, (1, 2))
        frames, joints = np.empty((s, k, 3, 3), np.float32), np.empty((s, k, 3), np.float32)
        frames[:, 0], joints[:, 0] = starts.rotation, rest_joints[:, 0] + starts.translation
        for j in range(1, k):
            up = self.parents[j]
            frames[:, j] = frames[:, up] @ local[:, j - 1]
            bone = (rest_joints[:, j] - rest_joints[:, up])[..., None]
            joints[:, j] = joints[:, up] + (frames[:, up] @ bone)[..., 0]
        shift = joints - (frames @ rest_joints[..., None])[..., 0]
        maps = np.concatenate([frames, shift[..., None]], axis=-1).reshape(s, k, 12)
        blended = (self.weights @ maps).reshape(s, -1, 3, 4)
        blend = blended[..., :3]
        vertices = (blend @ rest[..., None])[..., 0] + blended[..., 3]
        normals = (blend @ self.rest_normals[None, :, :, None])[..., 0]
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return PlacedBatch(vertices, normals, rest, frames, joints, shift, blend, left)

    def jacobian(self, placed: PlacedBatch) -> Single:
        """Return derivatives (S, V, 3, n): translation, left rotation, coefficients, shape."""
        s, v, k = *placed.vertices.shape[:2], len(self.parents)
        moment = self._moments(placed)
        out = np.zeros((s, v, 3, self.n), np.float32)
        out[..., :3] = np.eye(3, dtype=np.float32)
        root = moment[:, :, 0]
        out[..., 0, 4], out[..., 0, 5] = root[..., 2], -root[..., 1]
        out[..., 1, 3], out[..., 1, 5] = -root[..., 2], root[..., 0]
        out[..., 2, 3], out[..., 2, 4] = root[..., 1], -root[..., 0]
        axes = placed.frames[:, self.parents[1:]] @ placed.left
        turned = np.empty((s, v, 3, k - 1, 3), np.float32)
        _turn_columns(np.ascontiguousarray(axes), moment, turned)
        fingers = turned.reshape(-1, 3 * (k - 1)) @ self.basis.T
        out[..., 6 : 6 + COMPONENTS] = fingers.reshape(s, v, 3, COMPONENTS)
        out[..., 6 + COMPONENTS :] = self._shape_columns(placed)
        return out

    def _moments(self, placed: PlacedBatch) -> Single:
        """Sum what each joint's descendants carry of each vertex, about the joint: (S, V, K, 3)."""
        s, v, k = *placed.vertices.shape[:2], len(self.parents)
        flat = placed.frames.reshape(s, 3 * k, 3).transpose(0, 2, 1)
        moment = (placed.rest @ flat).reshape(s, v, k, 3)
        moment += placed.shift[:, None]
        moment *= self.weights[None, :, :, None]
        for j in range(k - 1, 0, -1):
            moment[:, :, self.parents[j]] += moment[:, :, j]
        moment -= self.carried[None, :, :, None] * placed.joints[:, None]
        return moment

    def _shape_columns(self, placed: PlacedBatch) -> Single:
        s, k = len(placed.joints), len(self.parents)
        moved = np.empty((s, k, 3, self.n_shape), np.float32)
        moved[:, 0] = self.joint_shapes[0]
        for j in range(1, k):
            up = self.parents[j]
            bone = self.joint_shapes[j] - self.joint_shapes[up]
            moved[:, j] = moved[:, up] + placed.frames[:, up] @ bone
        shift = (moved - placed.frames @ self.joint_shapes).reshape(s, k, -1)
        own = placed.blend @ self.shapedirs
        return own + (self.weights @ shift).reshape(own.shape)

    def to_vectors(self, starts: Starts) -> Array:
        """Return full parameter vectors (S, n)."""
        out = np.zeros((len(starts), self.surface.n))
        out[:, self.surface.translation] = starts.translation
        out[:, self.surface.root] = axis_angle_from_matrix(starts.rotation)
        out[:, self.surface.fingers] = self.mean + starts.coefficients @ self.basis
        out[:, self.surface.shape] = starts.shape
        return out

    def from_vectors(self, x: Array) -> Starts:
        """Return hypotheses of full vectors (S, n), projected onto the components."""
        s = self.surface
        offset = (x[:, s.fingers] - self.prior.mean) @ self.prior.components[:COMPONENTS].T
        coefficients = np.clip(offset / self.prior.sd[:COMPONENTS], -5, 5)
        rotation = matrix_from_axis_angle(x[:, s.root])
        return Starts(
            *(
                a.astype(np.float32)
                for a in (rotation, x[:, s.translation], coefficients, x[:, s.shape])
            )
        )


@lru_cache(maxsize=4)
def coarse_model_of(model: BodyModel, prior: HandPrior) -> CoarseModel:
    """Return the thinned hand of a model, made once per process."""
    return CoarseModel(surface_of(model), prior)


@njit(cache=True, error_model="numpy", fastmath=True)
def _turn_columns(axes: Any, moment: Any, out: Any) -> None:
    """Cross products axis x moment: axes (S, J, 3, 3), moment (S, V, J + 1, 3)."""
    for s in range(out.shape[0]):
        for v in range(out.shape[1]):
            for j in range(out.shape[3]):
                x, y, z = moment[s, v, j + 1, 0], moment[s, v, j + 1, 1], moment[s, v, j + 1, 2]
                for c in range(3):
                    ax, ay, az = axes[s, j, 0, c], axes[s, j, 1, c], axes[s, j, 2, c]
                    out[s, v, 0, j, c] = ay * z - az * y
                    out[s, v, 1, j, c] = az * x - ax * z
                    out[s, v, 2, j, c] = ax * y - ay * x


def spread(points: Array, count: int) -> NDArray[np.int64]:
    """Return ids of points far from one another (farthest point sampling)."""
    chosen = np.zeros(min(count, len(points)), dtype=np.int64)
    distance = np.full(len(points), np.inf)
    for i in range(1, len(chosen)):
        distance = np.minimum(distance, np.sum((points - points[chosen[i - 1]]) ** 2, axis=1))
        chosen[i] = int(np.argmax(distance))
    return chosen
