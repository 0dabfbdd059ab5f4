"""A model's skin as a function of one parameter vector, with all derivatives, in double precision.

The vector is ``[shape nb | pose 3 K | translation 3]``: betas, axis-angle radians, metres; the
columns of :meth:`synthgen.models.BodyModel.jacobian`.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.geometry.normals import face_cross, incidence, unit
from synthgen.geometry.rotations import cross_matrix
from synthgen.geometry.topology import boundary_edges
from synthgen.models import BodyModel, kernels
from synthgen.models.packed import fold_joints, largest_weights

if TYPE_CHECKING:
    from synthgen.models.jacobian import Jacobian

Array = NDArray[np.float64]
Found = tuple[Array, NDArray[np.int64], Array]


class Surface:
    """One model, ready to be placed and differentiated.

    Attributes
    ----------
    n : int
        Length of the parameter vector.
    shape, pose, root, fingers, translation : slice
        Where they lie in it.
    rim : (V,) bool
        Vertices of open boundaries (a hand's wrist ring).
    summed_from : int
        From so many points on, normal equations are summed on the mesh before parameters come in.
    """

    summed_from = 4000

    def __init__(self, model: BodyModel) -> None:
        self._check(model)
        self.model = model
        self.faces = np.ascontiguousarray(model.faces, dtype=np.int64)
        self.n_vertices, self.n_joints = model.weights.shape
        k = self.n_joints
        self.n = 3 + 3 * k + model.n_shape
        nb = model.n_shape
        self.shape, self.pose = slice(0, nb), slice(nb, nb + 3 * k)
        self.root, self.fingers = slice(nb, nb + 3), slice(nb + 3, nb + 3 * k)
        self.translation = slice(self.n - 3, self.n)
        self.rim = np.zeros(self.n_vertices, dtype=bool)
        self.rim[np.unique(boundary_edges(self.faces))] = True
        self.rim_face = self.rim[self.faces].any(axis=1)
        self._incidence = incidence(self.faces, self.n_vertices)
        self._prepare()

    def _check(self, model: BodyModel) -> None:
        if model.family not in ("mano", "smplh") or model.axis_meta is not None:
            raise ModelError(
                f"model {model.name!r} is of family {model.family!r}; the fitter takes mano, smplh "
                "and supr models in axis-angle"
            )

    def _prepare(self) -> None:
        """Lay out what placing and differentiating need."""
        model, k = self.model, self.n_joints
        self._joint_basis = fold_joints(model).reshape(1 + model.n_shape, -1)
        self._ids, self._weights = largest_weights(model.weights)
        self._posedirs = np.ascontiguousarray(model.posedirs[..., : 9 * (k - 1)])
        self._shapedirs = np.ascontiguousarray(model.shapedirs)

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

    def nearest(self, vertices: Array, points: Array, neighbours: int = 1) -> Found:
        """Closest points on a mesh of this surface's triangles (libigl).

        Returns squared distances (m,), faces (m,) and points (m, 3); ``neighbours`` is for bodies,
        whose search is not exact.
        """
        import igl

        found = igl.point_mesh_squared_distance(points, vertices, self.faces)
        return found[0], found[1], np.ascontiguousarray(found[2])


@lru_cache(maxsize=8)
def surface_of(model: BodyModel) -> Surface:
    """Return the surface of a model, made once per process."""
    if model.hand is not None:
        return Surface(model)
    from synthgen.registration.body_surface import BodySurface

    return BodySurface(model)


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
    def _slopes(self) -> Jacobian:
        return self.surface.model.jacobian(*self.surface.unpack(self.x))

    @property
    def jacobian(self) -> Array:
        """Derivatives (V, 3, n) of the vertices."""
        return self._slopes.values

    @property
    def joint_jacobian(self) -> Array:
        """Derivatives (K, 3, n) of the joints."""
        return self._slopes.joint_values

    def rows(self, triangle: NDArray[np.int64], barycentric: Array, direction: Array) -> Array:
        """Differentiate points on triangles (m, 3) along directions (m, 3): (m, n)."""
        return np.asarray(_rows(self.jacobian, triangle, barycentric, direction))

    def vertex_rows(self, vertices: NDArray[np.int64], direction: Array) -> Array:
        """Differentiate vertices (m,) along directions (m, 3): (m, n)."""
        return np.asarray(np.einsum("va,van->vn", direction, self.jacobian[vertices]))

    def nearest(self, points: Array, neighbours: int = 1) -> Found:
        """Closest points on the mesh; see :meth:`Surface.nearest`."""
        return self.surface.nearest(self.vertices, points, neighbours)


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
def _rows(jacobian: Any, triangle: Any, barycentric: Any, direction: Any) -> Any:
    """Differentiate points on triangles along directions: (m, n)."""
    out = np.zeros((len(triangle), jacobian.shape[2]))
    for i in range(len(triangle)):
        for corner in range(3):
            v, b = triangle[i, corner], barycentric[i, corner]
            x, y, z = b * direction[i, 0], b * direction[i, 1], b * direction[i, 2]
            for p in range(jacobian.shape[2]):
                out[i, p] += x * jacobian[v, 0, p] + y * jacobian[v, 1, p] + z * jacobian[v, 2, p]
    return out
