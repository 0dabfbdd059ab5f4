"""A body's skin as a function of one parameter vector; derivatives only where they are asked for.

The vector is ``[shape nb | pose 3 K | translation 3 | expression ne]``, as the columns of
:meth:`synthgen.models.BodyModel.jacobian`. A body's whole Jacobian is 20-30 ms and tens of
megabytes; a few thousand rows at surface points are 2-8 ms.
"""

from __future__ import annotations

import sys
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.errors import ModelError
from synthgen.models import BodyModel
from synthgen.models.arguments import Arguments
from synthgen.models.evaluation import driven, pose_skeleton, rest_points, skin_points
from synthgen.models.jacobian_kernels import joints_by_coefficients, world_axes
from synthgen.models.joints import FINGERS, SIDES
from synthgen.models.packed import shape_directions
from synthgen.models.pose_tangents import tangents
from synthgen.registration import body_kernels as kernels
from synthgen.registration.surface import Array, Found, Placed, Surface

if TYPE_CHECKING:
    from synthgen.models.jacobian import Jacobian


class BodySurface(Surface):
    """A body in SMPL+H or SUPR form, ready to be placed and differentiated.

    Attributes
    ----------
    expression : slice
        Of the vector; empty for SMPL+H.
    hands : dict of str to slice
        The 45 finger angles of "left" and "right".
    """

    summed_from = sys.maxsize  # its vertices outnumber the points

    def _check(self, model: BodyModel) -> None:
        if model.hand is not None or model.family not in ("smplh", "supr"):
            raise ModelError(
                f"model {model.name!r} is of family {model.family!r}; the fitter takes mano, smplh "
                "and supr models in axis-angle"
            )
        if model.axis_meta is not None:
            raise ModelError(f"model {model.name!r} is constrained; fit its axis-angle form")

    def _prepare(self) -> None:
        model = self.model
        self.expression = slice(self.n, self.n + model.n_expression)
        self.n += model.n_expression
        self.hands = {
            side: self._hand(side) for side in SIDES if f"{side}_index1" in model.joint_names
        }
        packed = model.packed_double
        parts = [shape_directions(model)]
        if model.exprdirs is not None:
            parts.append(model.exprdirs)
        self._directions = np.ascontiguousarray(np.concatenate(parts, axis=2))
        dense = packed.basis[: len(packed.dense)]
        self._dense = np.ascontiguousarray(dense.T.reshape(self.n_vertices, 3, len(packed.dense)))
        self._coefficient_joints = packed.joint_basis[1:].reshape(-1, self.n_joints, 3)
        self._first, self._around = triangles_around(self.faces, self.n_vertices)
        at = (self.shape, self.pose, self.translation, self.expression)
        self._columns = np.array([*(s.start for s in at), model.n_shape], dtype=np.int64)

    def _hand(self, side: str) -> slice:
        names = self.model.joint_names
        wanted = tuple(f"{side}_{finger}{k}" for finger in FINGERS for k in (1, 2, 3))
        first = names.index(wanted[0])
        if names[first : first + 15] != wanted:
            raise ModelError(
                f"model {self.model.name!r}: its {side} hand's joints are not in MANO order"
            )
        at = self.pose.start + 3 * first
        return slice(at, at + 45)

    def joint(self, name: str) -> slice:
        """Return where the three angles of a joint lie in the vector."""
        at = self.pose.start + 3 * self.model.joint_names.index(name)
        return slice(at, at + 3)

    def at(self, x: Array) -> BodyPlaced:
        """Place the skin."""
        return BodyPlaced(self, x)

    def nearest(self, vertices: Array, points: Array, neighbours: int = 1) -> Found:
        """Closest points on the triangles around the vertices nearest to each point.

        With one neighbour 3-4 % of the points are matched up to some millimetres off the closest,
        which a robust fit does not feel; with four it is 0.1 %.
        """
        return self.nearest_by(tree_over(vertices), vertices, points, neighbours)

    def nearest_by(self, tree: cKDTree, vertices: Array, points: Array, neighbours: int) -> Found:
        """Closest points, the vertices' search tree given."""
        found: Any = tree.query(points, k=neighbours)
        near = np.asarray(found[1], dtype=np.int64).reshape(len(points), -1)
        squared, face = np.empty(len(points)), np.zeros(len(points), dtype=np.int64)
        closest = np.empty((len(points), 3))
        kernels.nearest_on_rings(points, near, vertices, self.faces, self._first, self._around,
                                 squared, face, closest)  # fmt: skip
        return squared, face, closest


def tree_over(vertices: Array) -> cKDTree:
    """Search tree that is quick to make."""
    return cKDTree(vertices, balanced_tree=False, compact_nodes=False)


def triangles_around(
    faces: NDArray[np.int64], n_vertices: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first (V + 1,) and around: triangles at vertex v are around[first[v]:first[v+1]]."""
    order = np.argsort(faces.ravel(), kind="stable")
    first = np.zeros(n_vertices + 1, dtype=np.int64)
    np.cumsum(np.bincount(faces.ravel(), minlength=n_vertices), out=first[1:])
    return first, order // 3


class BodyPlaced(Placed):
    """The skin of a body at one parameter vector."""

    surface: BodySurface

    def __init__(self, surface: BodySurface, x: Array) -> None:
        self.surface, self.x = surface, x
        model, packed = surface.model, surface.model.packed_double
        given = Arguments(
            x[surface.shape][None], x[surface.pose].reshape(1, -1, 3),
            x[surface.translation][None], x[surface.expression][None],
        )  # fmt: skip
        self._skeleton = pose_skeleton(model, given, packed)
        drive = driven(packed, self._skeleton, given.translation)
        rest = rest_points(packed, drive, np.empty((1, 3 * surface.n_vertices)))
        posed = np.empty_like(rest)
        skin_points(packed, drive, rest, posed)
        self._rest, self.vertices = rest.reshape(-1, 3), posed.reshape(-1, 3)
        transforms = self._skeleton.transforms[0]
        self.frames = np.ascontiguousarray(transforms[:, :3, :3])
        self.joints = np.ascontiguousarray(transforms[:, :3, 3])

    @cached_property
    def normals(self) -> Array:
        """Unit vertex normals (V, 3), area weighted."""
        result = np.empty_like(self.vertices)
        kernels.vertex_normals(self.vertices, self.surface.faces, result)
        return result

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree over the vertices."""
        return tree_over(self.vertices)

    def nearest(self, points: Array, neighbours: int = 1) -> Found:
        """Closest points on the mesh; see :meth:`BodySurface.nearest`."""
        return self.surface.nearest_by(self.tree, self.vertices, points, neighbours)

    @cached_property
    def _slopes(self) -> Jacobian:
        s = self.surface
        expression = self.x[s.expression] if s.model.n_expression else None
        return s.model.jacobian(*s.unpack(self.x), expression)

    @property
    def joint_jacobian(self) -> Array:
        """Derivatives (K, 3, n) of the joints."""
        s = self.surface
        expression = self.x[s.expression] if s.model.n_expression else None
        none = np.zeros(0, dtype=np.int64)
        return s.model.jacobian(*s.unpack(self.x), expression, rows=none).joint_values

    @cached_property
    def _turns(self) -> tuple[Array, Array, Array, Array]:
        """World axes (K, 3, 3), slopes of features (K, 3, q) and maps (K, 3, c), shifts (K, 3)."""
        s, skeleton = self.surface, self._skeleton
        parents, transforms = s.model.packed_double.parents, skeleton.transforms[0]
        theta = self.x[s.pose].reshape(-1, 3)
        turned = tangents(s.model, theta, skeleton.rotations[0], skeleton.features.shape[2])
        axes = np.empty_like(turned.omega)
        world_axes(turned.omega, transforms, parents, axes)
        basis = s._coefficient_joints
        moved = np.empty((len(parents), 3, len(basis)))
        of_maps = np.empty_like(moved)
        joints_by_coefficients(basis, transforms, parents, moved, of_maps)
        shift = self.joints - np.einsum("kab,kb->ka", self.frames, skeleton.joints[0])
        return axes, turned.feature, of_maps, shift

    def rows(self, triangle: NDArray[np.int64], barycentric: Array, direction: Array) -> Array:
        """Differentiate points on triangles along directions: (m, n)."""
        s, packed = self.surface, self.surface.model.packed_double
        axes, feature, of_maps, shift = self._turns
        runs = packed.runs
        out = np.zeros((len(triangle), s.n))
        kernels.point_rows(
            triangle, barycentric, direction, self._rest, packed.joint_ids, packed.weights,
            packed.parents, self.frames, shift, self.joints, axes, s._directions, of_maps,
            packed.dense, s._dense, runs.start, runs.feature, runs.offset, runs.values, feature,
            s._columns, out,
        )  # fmt: skip
        return out

    def vertex_rows(self, vertices: NDArray[np.int64], direction: Array) -> Array:
        """Differentiate vertices along directions: (m, n)."""
        triangle = np.repeat(vertices[:, None], 3, axis=1)
        whole = np.tile([1.0, 0.0, 0.0], (len(vertices), 1))
        return self.rows(triangle, whole, np.ascontiguousarray(direction))
