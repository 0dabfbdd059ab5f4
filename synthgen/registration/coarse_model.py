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
        out = np.zeros((*placed.vertices.shape, self.n), np.float32)
        _move_columns(placed, out)
        axes = np.ascontiguousarray(placed.frames[:, self.parents[1:]] @ placed.left)
        _finger_columns(self.weights, self.parents, placed.rest, placed.frames, placed.shift,
                        placed.joints, axes, self.basis, out[..., 6 : 6 + COMPONENTS])  # fmt: skip
        out[..., 6 + COMPONENTS :] = self._shape_columns(placed, self.n_shape)
        return out

    def rigid_jacobian(self, placed: PlacedBatch) -> Single:
        """Return derivatives (S, V, 3, 7): translation, left rotation, first beta."""
        out = np.zeros((*placed.vertices.shape, 7), np.float32)
        _move_columns(placed, out)
        out[..., 6:] = self._shape_columns(placed, 1)
        return out

    def _shape_columns(self, placed: PlacedBatch, n: int) -> Single:
        s, k, by_shape = len(placed.joints), len(self.parents), self.joint_shapes[..., :n]
        moved = np.empty((s, k, 3, n), np.float32)
        moved[:, 0] = by_shape[0]
        for j in range(1, k):
            up = self.parents[j]
            bone = by_shape[j] - by_shape[up]
            moved[:, j] = moved[:, up] + placed.frames[:, up] @ bone
        shift = (moved - placed.frames @ by_shape).reshape(s, k, -1)
        own = placed.blend @ self.shapedirs[..., :n]
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


def _move_columns(placed: PlacedBatch, out: Single) -> None:
    """Write the columns of translation and left rotation, about the root joint."""
    arm = placed.vertices - placed.joints[:, None, 0]
    out[..., :3] = np.eye(3, dtype=np.float32)
    out[..., 0, 4], out[..., 0, 5] = arm[..., 2], -arm[..., 1]
    out[..., 1, 3], out[..., 1, 5] = -arm[..., 2], arm[..., 0]
    out[..., 2, 3], out[..., 2, 4] = arm[..., 1], -arm[..., 0]


@njit(cache=True, error_model="numpy", fastmath=True)
def _finger_columns(
    weights: Any, parents: Any, rest: Any, frames: Any, shift: Any, joints: Any, axes: Any,
    basis: Any, out: Any,
) -> None:  # fmt: skip
    """Add the columns of coefficients to out (S, V, 3, c); basis (c, 3 (K - 1)).

    A vertex moves with the few joints that carry it or its carriers: from the tips to the root,
    each joint hands its share of the vertex on to its parent, and turns it about its own axes.
    """
    k = len(parents)
    moment, mass = np.zeros((k, 3), np.float32), np.zeros(k, np.float32)
    by_angle = basis.T.copy()
    for s in range(out.shape[0]):
        for v in range(out.shape[1]):
            p, columns = rest[s, v], out[s, v]
            for j in range(k):
                w = weights[v, j]
                mass[j] = w
                for a in range(3):
                    f = frames[s, j, a]
                    moment[j, a] = w * (f[0] * p[0] + f[1] * p[1] + f[2] * p[2] + shift[s, j, a])
            for j in range(k - 1, 0, -1):
                w, up = mass[j], parents[j]
                if w == 0.0:
                    continue
                mass[up] += w
                for a in range(3):
                    moment[up, a] += moment[j, a]
                x = moment[j, 0] - w * joints[s, j, 0]
                y = moment[j, 1] - w * joints[s, j, 1]
                z = moment[j, 2] - w * joints[s, j, 2]
                for c in range(3):
                    u = axes[s, j - 1, :, c]
                    i, m, n = u[1] * z - u[2] * y, u[2] * x - u[0] * z, u[0] * y - u[1] * x
                    row = by_angle[3 * (j - 1) + c]
                    for q in range(len(row)):
                        columns[0, q] += i * row[q]
                        columns[1, q] += m * row[q]
                        columns[2, q] += n * row[q]


def spread(points: Array, count: int) -> NDArray[np.int64]:
    """Return ids of points far from one another (farthest point sampling)."""
    chosen = np.zeros(min(count, len(points)), dtype=np.int64)
    distance = np.full(len(points), np.inf)
    for i in range(1, len(chosen)):
        distance = np.minimum(distance, np.sum((points - points[chosen[i - 1]]) ** 2, axis=1))
        chosen[i] = int(np.argmax(distance))
    return chosen
