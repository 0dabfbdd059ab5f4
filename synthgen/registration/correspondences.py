"""Correspondences: scan points and their closest points on a placed mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.registration.free_mesh import walked_to
from synthgen.registration.surface import Placed

Array = NDArray[np.float64]
# Of Phong's bulge over a triangle, what the smooth surface through its vertices has.
SMOOTH = 0.5
# Half the width of a ramp of cosines, and of weights on inner vertices, over which a pair comes in.
SOFT, INNER = 0.15, 0.3


@dataclass(frozen=True, eq=False)
class Pairs:
    """Scan points and their closest points on the mesh.

    Attributes
    ----------
    face : (m,) int64; triangle : (m, 3) int64 vertex ids; barycentric, shift, normal : (m, 3)
        The closest point is ``sum barycentric vertex + shift``; the shift leads from the flat
        triangle to the curved surface.
    squared : (m,) metres^2
        From the curved surface along its normal: the point above a triangle's closest one is not
        the closest itself, and what it lies aside has nothing to do with the fit.
    kept : (m,) bool, near enough, facing alike, not off the rim
    rim : (m,) bool, closest point on an open boundary
    trust : (m,) in 0..1
        Near enough and facing alike, without a step at the limit: an energy that leaps when a
        point comes in refuses steps that are right.
    inner : (m,) in 0..1
        0 on the rim, 1 a third of a triangle away from it.
    """

    face: NDArray[np.int64]
    triangle: NDArray[np.int64]
    barycentric: Array
    shift: Array
    normal: Array
    squared: Array
    kept: NDArray[np.bool_]
    rim: NDArray[np.bool_]
    trust: Array
    inner: Array

    @property
    def corner(self) -> NDArray[np.int64]:
        """Vertex (m,) nearest to each closest point within its triangle."""
        rows = np.arange(len(self.triangle))
        return np.asarray(self.triangle[rows, self.barycentric.argmax(axis=1)])


def closest(
    placed: Placed,
    points: Array,
    normals: Array,
    *,
    cut_m: float,
    cosine: float,
    curved: float = 0.0,
    neighbours: int = 1,
    start: NDArray[np.int64] | None = None,
) -> Pairs:
    """Closest points on the mesh, with interpolated (Phong) normals.

    ``start`` (m,) are vertices near the closest points, -1 where not known: a walk from there is
    much cheaper than a search.

    ``curved`` blends from flat triangles (0) to Phong tessellation (1; Boubekeur and Alexa 2008).
    To second order that rises twice as high over a triangle as the smooth surface through its
    vertices with their normals: 0.5 is that surface, which a renderer draws and which skin is.
    """
    s = placed.surface
    if start is None:
        squared, face, point = placed.nearest(points, neighbours)
    else:
        squared, face, point = walked_to(s, placed.vertices, points, np.maximum(start, 0))
        lost = np.flatnonzero(start < 0)
        if len(lost):
            squared[lost], face[lost], point[lost] = placed.nearest(points[lost], neighbours)
    triangle = s.faces[face]
    barycentric, normal = np.empty((len(points), 3)), np.empty((len(points), 3))
    agree, shift = np.empty(len(points)), np.empty((len(points), 3))
    inner = np.empty(len(points))
    _attributes(placed.vertices, placed.normals, triangle, point, normals, s.rim, curved, points,
                barycentric, shift, squared, normal, agree, inner)  # fmt: skip
    rim = inner < 1e-9
    kept = (squared < cut_m**2) & (agree > cosine) & ~rim
    trust = np.where(squared < cut_m**2, ramp(agree, cosine), 0)
    inner = np.minimum(inner / INNER, 1)
    return Pairs(face, triangle, barycentric, shift, normal, squared, kept, rim, trust, inner)


def ramp(cosines: Array, limit: float) -> Array:
    """Return 0 well below a limit of cosines and 1 well above it."""
    return np.clip(0.5 + (cosines - limit) / (2 * SOFT), 0, 1)


@njit(cache=True, error_model="numpy", fastmath=True)
def _attributes(
    vertices: Any, vertex_normals: Any, triangle: Any, point: Any, scan_normals: Any, rim: Any,
    curved: float, scan: Any, barycentric: Any, shift: Any, squared: Any, normal: Any, agree: Any,
    inner: Any,
) -> None:  # fmt: skip
    """Barycentrics of points on triangles, Phong normals, cosines, weights on inner vertices."""
    for i in range(len(triangle)):
        a, b, c = triangle[i, 0], triangle[i, 1], triangle[i, 2]
        uu, uv, vv, wu, wv = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            u, v = vertices[b, k] - vertices[a, k], vertices[c, k] - vertices[a, k]
            w = point[i, k] - vertices[a, k]
            uu, uv, vv, wu, wv = uu + u * u, uv + u * v, vv + v * v, wu + w * u, wv + w * v
        area = max(uu * vv - uv * uv, 1e-30)
        x, y = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
        z = 1.0 - x - y
        barycentric[i, 0], barycentric[i, 1], barycentric[i, 2] = z, x, y
        total, cosine = 0.0, 0.0
        for k in range(3):
            n = z * vertex_normals[a, k] + x * vertex_normals[b, k] + y * vertex_normals[c, k]
            normal[i, k] = n
            total += n * n
            cosine += n * scan_normals[i, k]
        length = max(np.sqrt(total), 1e-12)
        for k in range(3):
            normal[i, k] /= length
        agree[i] = cosine / length
        if curved > 0.0:
            moved_x, moved_y, moved_z = 0.0, 0.0, 0.0
            for corner in range(3):
                v, share = triangle[i, corner], barycentric[i, corner]
                above = 0.0
                for k in range(3):
                    above += (vertices[v, k] - point[i, k]) * vertex_normals[v, k]
                moved_x += share * above * vertex_normals[v, 0]
                moved_y += share * above * vertex_normals[v, 1]
                moved_z += share * above * vertex_normals[v, 2]
            shift[i, 0], shift[i, 1], shift[i, 2] = moved_x, moved_y, moved_z
            total = 0.0
            for k in range(3):
                shift[i, k] *= curved
                total += (point[i, k] + shift[i, k] - scan[i, k]) * normal[i, k]
            squared[i] = total * total
        else:
            shift[i] = 0.0
        inner[i] = (0.0 if rim[a] else z) + (0.0 if rim[b] else x) + (0.0 if rim[c] else y)
