"""A model's skin as a function of one parameter vector, with all derivatives, in double precision.

The vector is ``[translation 3 | pose 3 K | shape nb]``: metres, axis-angle radians, betas. Its
derivatives are those of :mod:`synthgen.models.reference`, written per vertex: a joint turns the
part of a vertex that its descendants carry, and bends the correctives of its own rotation.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.geometry.normals import face_cross, incidence, unit
from synthgen.geometry.rotations import cross_matrix
from synthgen.geometry.topology import boundary_edges
from synthgen.models import BodyModel, kernels
from synthgen.models.packed import fold_joints, largest_weights

Array = NDArray[np.float64]
_SMALL = 1e-4


class Surface:
    """One model, ready to be placed and differentiated.

    Attributes
    ----------
    n : int
        Length of the parameter vector.
    translation, root, fingers, pose, shape : slice
        Where they lie in it.
    rim : (V,) bool
        Vertices of open boundaries (a hand's wrist ring).
    """

    def __init__(self, model: BodyModel) -> None:
        if model.family not in ("mano", "smplh") or model.axis_meta is not None:
            raise ModelError(
                f"model {model.name!r} is of family {model.family!r}; the fitter takes mano and "
                "smplh models in axis-angle"
            )
        self.model = model
        self.faces = np.ascontiguousarray(model.faces, dtype=np.int64)
        self.n_vertices, self.n_joints = model.weights.shape
        k = self.n_joints
        self.n = 3 + 3 * k + model.n_shape
        self.translation, self.root = slice(0, 3), slice(3, 6)
        self.pose, self.fingers = slice(3, 3 + 3 * k), slice(6, 3 + 3 * k)
        self.shape = slice(3 + 3 * k, self.n)
        self.rim = np.zeros(self.n_vertices, dtype=bool)
        self.rim[np.unique(boundary_edges(self.faces))] = True
        self.rim_face = self.rim[self.faces].any(axis=1)
        self._joint_basis = fold_joints(model).reshape(1 + model.n_shape, -1)
        self._ids, self._weights = largest_weights(model.weights)
        self._posedirs = np.ascontiguousarray(model.posedirs[..., : 9 * (k - 1)])
        blocks = self._posedirs.reshape(self.n_vertices, 3, k - 1, 9)
        self._active = np.any(blocks != 0, axis=(1, 3))
        self._shapedirs = np.ascontiguousarray(model.shapedirs)
        self._incidence = incidence(self.faces, self.n_vertices)

    def pack(self, shape: Array, pose: Array, translation: Array) -> Array:
        """Return the vector of shape (nb,), pose (K, 3), translation (3,); few betas are filled."""
        x = np.zeros(self.n)
        x[self.translation], x[self.pose] = translation, np.asarray(pose).ravel()
        x[self.shape.start : self.shape.start + len(shape)] = shape
        return x

    def unpack(self, x: Array) -> tuple[Array, Array, Array]:
        """Return shape (nb,), pose (K, 3), translation (3,)."""
        return x[self.shape].copy(), x[self.pose].reshape(-1, 3).copy(), x[self.translation].copy()

    def at(self, x: Array) -> Placed:
        """Place the skin."""
        return Placed(self, x)


@lru_cache(maxsize=8)
def surface_of(model: BodyModel) -> Surface:
    """Return the surface of a model, made once per process."""
    return Surface(model)


class Placed:
    """The skin at one parameter vector; derivatives are made when they are asked for.

    Attributes
    ----------
    x : (n,) float64
    vertices : (V, 3), joints : (K, 3), metres
    """

    def __init__(self, surface: Surface, x: Array) -> None:
        self.surface, self.x = surface, x
        k = surface.n_joints
        theta, beta = x[surface.pose].reshape(k, 3), x[surface.shape]
        self._rotations, features = np.empty((1, k, 3, 3)), np.empty((1, k, 9))
        kernels.turn(theta[None], 9, self._rotations, features)
        rest, transforms, skin = np.empty((1, k, 3)), np.empty((1, k, 4, 4)), np.empty((1, k, 12))
        kernels.place(
            np.concatenate([[1.0], beta])[None], surface._joint_basis, self._rotations,
            surface.model.parents, x[surface.translation][None], rest, transforms, skin,
        )  # fmt: skip
        self.frames: Array = np.ascontiguousarray(transforms[0, :, :3, :3])
        self.joints: Array = np.ascontiguousarray(transforms[0, :, :3, 3])
        self._shift = self.joints - np.einsum("kab,kb->ka", self.frames, rest[0])
        self._rest = surface.model.v_template + surface._shapedirs @ beta
        self._rest += surface._posedirs @ features[0, 1:].ravel()
        self.vertices: Array = np.empty((surface.n_vertices, 3))
        _skin(self._rest, self.frames, self._shift, surface._ids, surface._weights, self.vertices)

    @cached_property
    def normals(self) -> Array:
        """Unit vertex normals (V, 3), area weighted."""
        s = self.surface
        return unit(s._incidence @ face_cross(self.vertices, s.faces))

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives (V, 3, n) of the vertices."""
        s = self.surface
        theta = self.x[s.pose].reshape(-1, 3)
        left = left_jacobian(theta)
        slopes = np.einsum("jabc,jcd->jabd", cross_matrix(left.transpose(0, 2, 1)),
                           self._rotations[0])[1:]  # fmt: skip
        out = np.empty((s.n_vertices, 3, s.n))
        _differentiate(
            self._rest, s._posedirs, s._active, slopes.reshape(-1, 3, 9), self.frames,
            self._shift, self.joints, self._axes(left), s.model.parents, s._ids, s._weights,
            s._shapedirs, self._joint_shapes[1], out,
        )  # fmt: skip
        return out

    def _axes(self, left: Array) -> Array:
        """World axes (K, 3, 3) that a joint's angles turn about, columns."""
        up = np.concatenate([np.eye(3)[None], self.frames[self.surface.model.parents[1:]]])
        return up @ left

    @cached_property
    def _joint_shapes(self) -> tuple[Array, Array]:
        """Derivatives by shape of joints (K, 3, nb) and of the maps' shifts (K, 3, nb)."""
        s = self.surface
        rest = s._joint_basis[1:].reshape(-1, s.n_joints, 3).transpose(1, 2, 0)
        moved = np.empty_like(rest)
        moved[0] = rest[0]
        for k in range(1, s.n_joints):
            q = s.model.parents[k]
            moved[k] = moved[q] + self.frames[q] @ (rest[k] - rest[q])
        return moved, np.ascontiguousarray(moved - self.frames @ rest)

    @cached_property
    def joint_jacobian(self) -> Array:
        """Derivatives (K, 3, n) of the joints."""
        s, k = self.surface, self.surface.n_joints
        axes = self._axes(left_jacobian(self.x[s.pose].reshape(-1, 3)))
        out = np.zeros((k, 3, s.n))
        out[:, :, :3] = np.eye(3)
        out[:, :, s.shape] = self._joint_shapes[0]
        for joint in range(1, k):
            up = int(s.model.parents[joint])
            while up >= 0:
                arm = self.joints[joint] - self.joints[up]
                out[joint, :, 3 + 3 * up : 6 + 3 * up] = np.cross(axes[up].T, arm).T
                up = int(s.model.parents[up])
        return out


def left_jacobian(theta: Array) -> Array:
    """Left Jacobian (K, 3, 3) of SO(3): exp(theta + d) = exp(J d) exp(theta) to first order."""
    squared = np.sum(theta * theta, axis=-1)[:, None, None]
    angle = np.sqrt(squared)
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    b = np.where(small, 0.5 - squared / 24, (1 - np.cos(safe)) / safe**2)
    c = np.where(small, 1 / 6 - squared / 120, (safe - np.sin(safe)) / safe**3)
    k = cross_matrix(theta)
    result: Array = np.eye(3) + b * k + c * (k @ k)
    return result


@njit(cache=True, error_model="numpy", fastmath=True)
def _skin(rest: Any, frames: Any, shift: Any, ids: Any, weights: Any, out: Any) -> None:
    for v in range(len(rest)):
        for a in range(3):
            total = 0.0
            for i in range(ids.shape[1]):
                w, k = weights[v, i], ids[v, i]
                f = frames[k]
                total += w * (
                    f[a, 0] * rest[v, 0] + f[a, 1] * rest[v, 1] + f[a, 2] * rest[v, 2] + shift[k, a]
                )
            out[v, a] = total


@njit(cache=True, error_model="numpy", fastmath=True)
def _differentiate(
    rest: Any, posedirs: Any, active: Any, slopes: Any, frames: Any, shift: Any, joints: Any,
    axes: Any, parents: Any, ids: Any, weights: Any, shapedirs: Any, shift_shapes: Any, out: Any,
) -> None:  # fmt: skip
    """Fill out (V, 3, n); slopes (K - 1, 3, 9) are d(R - I) by the three angles of a joint."""
    n_joints, nb = len(parents), shapedirs.shape[2]
    first = 3 + 3 * n_joints
    moment, carried = np.empty((n_joints, 3)), np.empty(n_joints)
    blend = np.empty((3, 3))
    for v in range(len(rest)):
        out[v] = 0.0
        moment[:] = 0.0
        carried[:] = 0.0
        blend[:] = 0.0
        for i in range(ids.shape[1]):
            w, k = weights[v, i], ids[v, i]
            if w == 0.0:
                continue
            for a in range(3):
                g = frames[k, a]
                point = w * (
                    g[0] * rest[v, 0] + g[1] * rest[v, 1] + g[2] * rest[v, 2] + shift[k, a]
                )
                for c in range(3):
                    blend[a, c] += w * g[c]
                for b in range(nb):
                    out[v, a, first + b] += w * shift_shapes[k, a, b]
                up = k
                while up >= 0:
                    moment[up, a] += point
                    up = parents[up]
            up = k
            while up >= 0:
                carried[up] += w
                up = parents[up]
        for a in range(3):
            out[v, a, a] = 1.0
            for b in range(nb):
                out[v, a, first + b] += (
                    blend[a, 0] * shapedirs[v, 0, b]
                    + blend[a, 1] * shapedirs[v, 1, b]
                    + blend[a, 2] * shapedirs[v, 2, b]
                )
        for j in range(n_joints):
            if carried[j] > 0.0:
                x = moment[j, 0] - carried[j] * joints[j, 0]
                y = moment[j, 1] - carried[j] * joints[j, 1]
                z = moment[j, 2] - carried[j] * joints[j, 2]
                for c in range(3):
                    ax, ay, az = axes[j, 0, c], axes[j, 1, c], axes[j, 2, c]
                    at = 3 + 3 * j + c
                    out[v, 0, at] = ay * z - az * y
                    out[v, 1, at] = az * x - ax * z
                    out[v, 2, at] = ax * y - ay * x
            if j > 0 and active[v, j - 1]:
                for c in range(3):
                    dx, dy, dz = 0.0, 0.0, 0.0
                    for m in range(9):
                        s, f = slopes[j - 1, c, m], 9 * (j - 1) + m
                        dx += s * posedirs[v, 0, f]
                        dy += s * posedirs[v, 1, f]
                        dz += s * posedirs[v, 2, f]
                    for a in range(3):
                        out[v, a, 3 + 3 * j + c] += (
                            blend[a, 0] * dx + blend[a, 1] * dy + blend[a, 2] * dz
                        )
