"""A triangle mesh whose vertices are unknowns: closest points and one quadratic, by kernels.

The quadratic is ``sum w (n . (V(b) - p))^2 + |D (V - M)|^2 / edge_sd^2 + |V - M|^2 / tie_sd^2``:
3 x 3 blocks on vertices and edges only. Meshes have thousands of vertices and each solution starts
at the one before, so conjugate gradients with a block-Jacobi preconditioner beat factorisations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from synthgen.geometry.normals import face_cross, incidence, unit
from synthgen.geometry.topology import boundary_edges

if TYPE_CHECKING:
    from synthgen.registration.surface import Surface

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
HOPS = 8


@dataclass(frozen=True, eq=False)
class Topology:
    """What does not move.

    Attributes
    ----------
    faces : (F, 3), edges : (E, 2), face_edges : (F, 3)
        ``face_edges[f, k]`` joins corners k and k + 1.
    ring_start : (V + 1,), ring : (3 F,)
        Faces around each vertex.
    link_start : (V + 1,), link : (2 E, 2)
        Neighbour and edge of each vertex.
    rim : (V,) bool
        Vertices of open boundaries.
    touch : (V, F) sparse
    """

    faces: Ints
    edges: Ints
    face_edges: Ints
    ring_start: Ints
    ring: Ints
    link_start: Ints
    link: Ints
    rim: NDArray[np.bool_]
    touch: sparse.csr_matrix

    @property
    def laplacian(self) -> sparse.csr_matrix:
        """D^T D (V, V) of the edge differences D."""
        m, v = len(self.edges), len(self.rim)
        rows, signs = np.repeat(np.arange(m), 2), np.tile([1.0, -1.0], m)
        d = sparse.csr_matrix((signs, (rows, self.edges.ravel())), (m, v))
        return sparse.csr_matrix(d.T @ d)


def topology(faces: NDArray[Any], n_vertices: int) -> Topology:
    """Index a mesh."""
    f = np.ascontiguousarray(faces, dtype=np.int64)
    sides = np.sort(np.stack([f, np.roll(f, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, own = np.unique(sides, axis=0, return_inverse=True)
    order = np.argsort(f.ravel(), kind="stable")
    ends = np.concatenate([edges, edges[:, ::-1]])
    link = np.stack([ends[:, 1], np.tile(np.arange(len(edges)), 2)], axis=1)
    rim = np.zeros(n_vertices, dtype=bool)
    rim[np.unique(boundary_edges(f))] = True
    return Topology(
        faces=f,
        edges=edges,
        face_edges=own.reshape(-1, 3),
        ring_start=_starts(f.ravel(), n_vertices),
        ring=order // 3,
        link_start=_starts(ends[:, 0], n_vertices),
        link=link[np.argsort(ends[:, 0], kind="stable")],
        rim=rim,
        touch=incidence(f, n_vertices),
    )


def _starts(ids: Ints, n: int) -> Ints:
    return np.concatenate([[0], np.cumsum(np.bincount(ids, minlength=n))])


@dataclass(frozen=True, eq=False)
class Closest:
    """Closest points of a mesh: face (m,), barycentric (m, 3), squared distance (m,)."""

    face: Ints
    barycentric: Array
    squared: Array

    def corner(self, mesh: Topology) -> Ints:
        """Nearest corner (m,) of each point's face."""
        return np.asarray(mesh.faces[self.face, self.barycentric.argmax(axis=1)])


def closest_exact(mesh: Topology, vertices: Array, points: Array) -> Closest:
    """Closest points by libigl's tree."""
    import igl

    squared, face, foot = igl.point_mesh_squared_distance(points, vertices, mesh.faces)[:3]
    a, b, c = (np.ascontiguousarray(vertices[mesh.faces[face, k]]) for k in range(3))
    return Closest(face, igl.barycentric_coordinates(foot, a, b, c), squared)


def closest_walk(mesh: Topology, vertices: Array, points: Array, start: Ints) -> Closest:
    """Closest points by walking over rings of faces from a vertex (m,) each.

    Look at the faces around a vertex and go on to the vertex nearest to the best of them until
    nothing improves. From where a point was before the mesh moved a little, that is exact but for
    some 0.1 % of the points and costs an eighth of a search. From the nearest vertex it is not good
    enough: where a finger touches the palm it takes the wrong one of two skins (1 % of the points,
    and 15 % of closed fists were lost).
    """
    face, b = np.empty(len(points), np.int64), np.empty((len(points), 3))
    squared = np.empty(len(points))
    _walk(points, vertices, mesh.faces, mesh.ring_start, mesh.ring, start, face, b, squared)
    return Closest(face, b, squared)


@lru_cache(maxsize=8)
def mesh_of(surface: Surface) -> Topology:
    """Topology of a surface, made once."""
    return topology(surface.faces, surface.n_vertices)


def walked_to(
    surface: Surface, vertices: Array, points: Array, start: Ints
) -> tuple[Array, Ints, Array]:
    """Squared distances (m,), faces (m,) and closest points (m, 3), walking from vertices."""
    mesh = mesh_of(surface)
    at = closest_walk(mesh, vertices, np.ascontiguousarray(points), start)
    corners = vertices[mesh.faces[at.face]]
    return at.squared, at.face, np.einsum("mk,mka->ma", at.barycentric, corners)


@dataclass(frozen=True, eq=False)
class Quadratic:
    """``V^T K V / 2 - V^T pull`` with data blocks (V, 3, 3), (E, 3, 3) and isotropic ties.

    Attributes
    ----------
    diagonal, across : data blocks of vertices and edges
    pull : (V, 3)
        Of the data alone.
    edge, tie : float
        1 / sd^2 of an edge difference and of a vertex.
    kept : (m,) bool
        Points that take part.
    """

    mesh: Topology
    diagonal: Array
    across: Array
    pull: Array
    edge: float
    tie: float
    kept: NDArray[np.bool_]

    def solve(self, model: Array, guess: Array, tolerance: float, most: int = 200) -> Array:
        """Return the best vertices (V, 3) beside a model (V, 3), metres; starts at a guess.

        ``tolerance`` is the length, metres, under which no vertex needs to move (rms, in the norm
        of the preconditioner).
        """
        degree = np.diff(self.mesh.link_start)
        own = self.diagonal + (self.edge * degree + self.tie)[:, None, None] * np.eye(3)
        x = (guess - model).copy()
        pull = self.pull - _product(self.mesh, self.diagonal, self.across, 0.0, model)
        _gradients(own, np.linalg.inv(own), self.across, self.edge, self.mesh.link_start,
                   self.mesh.link, pull, x, tolerance**2 * len(x), most)  # fmt: skip
        return model + x


def _product(mesh: Topology, diagonal: Array, across: Array, edge: float, x: Array) -> Array:
    out = np.empty_like(x)
    _multiply(diagonal, across, edge, mesh.link_start, mesh.link, x, out)
    return out


def quadratic(
    mesh: Topology,
    vertices: Array,
    points: Array,
    normals: Array,
    at: Closest,
    *,
    noise_m: float,
    edge_sd_m: float,
    tie_sd_m: float,
    sigma_m: float,
    cut_m: float,
    cosine: float,
) -> Quadratic:
    """Sum point-to-plane distances of points (m, 3), Geman-McClure weighted, into blocks."""
    smooth = unit(mesh.touch @ face_cross(vertices, mesh.faces))
    diagonal, across = np.zeros((len(vertices), 3, 3)), np.zeros((len(mesh.edges), 3, 3))
    pull, kept = np.zeros_like(vertices), np.zeros(len(points), np.bool_)
    _assemble(points, normals, smooth, mesh.faces, mesh.face_edges, mesh.rim, at.face,
              at.barycentric, at.squared, sigma_m**2, cut_m**2, cosine, 1 / noise_m**2, diagonal,
              across, pull, kept)  # fmt: skip
    return Quadratic(mesh, diagonal, across, pull, 1 / edge_sd_m**2, 1 / tie_sd_m**2, kept)


@njit(cache=True, error_model="numpy", fastmath=True)
def _on_triangle(p: Any, a: Any, b: Any, c: Any) -> Any:
    """Squared distance and barycentrics of the closest point (Ericson 2005, 5.1.5)."""
    ab0, ab1, ab2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    ac0, ac1, ac2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    ap0, ap1, ap2 = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    d1, d2 = ab0 * ap0 + ab1 * ap1 + ab2 * ap2, ac0 * ap0 + ac1 * ap1 + ac2 * ap2
    e, f, g = ab0 * ab0 + ab1 * ab1 + ab2 * ab2, ab0 * ac0 + ab1 * ac1 + ab2 * ac2, 0.0
    g = ac0 * ac0 + ac1 * ac1 + ac2 * ac2
    d3, d4, d5, d6 = d1 - e, d2 - f, d1 - f, d2 - g
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    x, y, z = ap0 - v * ab0 - w * ac0, ap1 - v * ab1 - w * ac1, ap2 - v * ab2 - w * ac2
    return x * x + y * y + z * z, v, w


@njit(cache=True, error_model="numpy", fastmath=True)
def _walk(
    points: Any, vertices: Any, faces: Any, ring_start: Any, ring: Any, start: Any, face: Any,
    barycentric: Any, squared: Any,
) -> None:  # fmt: skip
    for i in range(len(points)):
        at, best, own, v, w = start[i], np.inf, 0, 0.0, 0.0
        for _ in range(HOPS):
            better = False
            for k in range(ring_start[at], ring_start[at + 1]):
                f = ring[k]
                p, q, r = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
                d, b, c = _on_triangle(points[i], p, q, r)
                if d < best:
                    best, own, v, w, better = d, f, b, c, True
            u = 1.0 - v - w
            corner = 0 if u >= v and u >= w else (1 if v >= w else 2)
            if not better or faces[own, corner] == at:
                break
            at = faces[own, corner]
        face[i], squared[i] = own, best
        barycentric[i, 0], barycentric[i, 1], barycentric[i, 2] = 1.0 - v - w, v, w


@njit(cache=True, error_model="numpy", fastmath=True)
def _assemble(
    points: Any, normals: Any, smooth: Any, faces: Any, face_edges: Any, rim: Any, face: Any,
    barycentric: Any, squared: Any, s2: float, cut2: float, least: float, information: float,
    diagonal: Any, across: Any, pull: Any, kept: Any,
) -> None:  # fmt: skip
    n = np.empty(3)
    for i in range(len(points)):
        f = face[i]
        inner, length, cosine, target = 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            inner += 0.0 if rim[faces[f, k]] else barycentric[i, k]
        for a in range(3):
            n[a] = 0.0
            for k in range(3):
                n[a] += barycentric[i, k] * smooth[faces[f, k], a]
            length += n[a] * n[a]
            cosine += n[a] * normals[i, a]
        length = max(np.sqrt(length), 1e-12)
        if squared[i] >= cut2 or cosine <= least * length or inner < 1e-9:
            continue
        kept[i] = True
        for a in range(3):
            n[a] /= length
            target += n[a] * points[i, a]
        weight = information * (s2 / (s2 + squared[i])) ** 2
        for k in range(3):
            v, b = faces[f, k], weight * barycentric[i, k]
            own, next_ = b * barycentric[i, k], b * barycentric[i, (k + 1) % 3]
            for a in range(3):
                pull[v, a] += b * n[a] * target
                for c in range(3):
                    diagonal[v, a, c] += own * n[a] * n[c]
                    across[face_edges[f, k], a, c] += next_ * n[a] * n[c]


@njit(cache=True, error_model="numpy", fastmath=True)
def _multiply(
    own: Any, across: Any, edge: float, link_start: Any, link: Any, x: Any, out: Any
) -> None:
    """Product of the blocks with x; ``own`` holds the whole diagonal."""
    for v in range(len(x)):
        p, q, r = x[v, 0], x[v, 1], x[v, 2]
        d = own[v]
        a = d[0, 0] * p + d[0, 1] * q + d[0, 2] * r
        b = d[1, 0] * p + d[1, 1] * q + d[1, 2] * r
        c = d[2, 0] * p + d[2, 1] * q + d[2, 2] * r
        for k in range(link_start[v], link_start[v + 1]):
            j, e = link[k, 0], across[link[k, 1]]
            p, q, r = x[j, 0], x[j, 1], x[j, 2]
            a += e[0, 0] * p + e[0, 1] * q + e[0, 2] * r - edge * p
            b += e[1, 0] * p + e[1, 1] * q + e[1, 2] * r - edge * q
            c += e[2, 0] * p + e[2, 1] * q + e[2, 2] * r - edge * r
        out[v, 0], out[v, 1], out[v, 2] = a, b, c


@njit(cache=True, error_model="numpy", fastmath=True)
def _precondition(inverse: Any, r: Any, z: Any) -> float:
    total = 0.0
    for v in range(len(r)):
        for a in range(3):
            z[v, a] = (
                inverse[v, a, 0] * r[v, 0] + inverse[v, a, 1] * r[v, 1] + inverse[v, a, 2] * r[v, 2]
            )
            total += z[v, a] * r[v, a]
    return total


@njit(cache=True, error_model="numpy", fastmath=True)
def _gradients(
    own: Any, inverse: Any, across: Any, edge: float, link_start: Any, link: Any, pull: Any, x: Any,
    limit: float, most: int,
) -> int:  # fmt: skip
    """Preconditioned conjugate gradients on x in place; stops when |P r|^2 falls below limit."""
    y, z = np.empty_like(x), np.empty_like(x)
    _multiply(own, across, edge, link_start, link, x, y)
    r = pull - y
    rz = _precondition(inverse, r, z)
    p = z.copy()
    for step in range(most):
        if np.sum(z * z) < limit:
            return step
        _multiply(own, across, edge, link_start, link, p, y)
        alpha = rz / max(np.sum(p * y), 1e-300)
        x += alpha * p
        r -= alpha * y
        fresh = _precondition(inverse, r, z)
        p = z + fresh / max(rz, 1e-300) * p
        rz = fresh
    return most
