"""One triangle mesh for a whole scene, fine enough that light can be kept at its vertices.

Triangles are only split, never moved: what is drawn is what the scene describes, and every drawn
triangle knows its parent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import face_cross, unit
from synthgen.geometry.subdivision import CHILDREN
from synthgen.scanner.subject import ScanScene, Solid

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

MAX_FACES = 2_000_000
_MAX_LEVELS = 10


@dataclass(frozen=True, eq=False)
class Part:
    """One solid of the drawn mesh.

    Attributes
    ----------
    solid : Solid
    levels : int
        How often its triangles were split in four; children of face f are rows
        ``f * 4**levels`` onwards.
    faces : (F, 3) int64
        Into its own ``points``; smooth and flat solids alike share vertices here.
    points : (P, 3) float64
        Split vertices, at time 0; the solid's own come first.
    pairs : list of (n, 2) int64
        For each level, the two ends whose middle is a new vertex.
    first_face, first_vertex : int
        Where it begins in the drawn mesh.
    source : (V,) int64
        Row of ``points`` for each of its drawn vertices.
    """

    solid: Solid
    levels: int
    faces: Ids
    points: Array
    pairs: tuple[Ids, ...]
    first_face: int
    first_vertex: int
    source: Ids

    def spread(self, values: Array) -> Array:
        """Interpolate values at the solid's own vertices (V, ...) to its points (P, ...)."""
        for ends in self.pairs:
            values = np.concatenate([values, values[ends].mean(axis=1)])
        return values


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """All solids as one mesh; flat solids have their vertices apart, with the faces' normals.

    Attributes
    ----------
    parts : tuple of Part
    vertices, normals : (V, 3) float64
        At time 0; unit normals.
    faces : (F, 3) int64
    solid_of_face : (F,) int64
    """

    parts: tuple[Part, ...]
    vertices: Array
    normals: Array
    faces: Ids
    solid_of_face: Ids

    def at(self, time_s: float) -> Array:
        """Return the drawn vertices (V, 3) at a time."""
        return np.concatenate(
            [part.spread(part.solid.at(time_s))[part.source] for part in self.parts]
        )

    def parent(self, drawn: Ids, barycentric: Array) -> tuple[Ids, Ids, Array]:
        """Return solid (n,), face of the solid (n,) and barycentrics there (n, 3) of drawn hits."""
        solid = self.solid_of_face[drawn]
        face, inside = np.zeros_like(drawn), np.zeros_like(barycentric)
        for k, part in enumerate(self.parts):
            own = solid == k
            local = drawn[own] - part.first_face
            children = 4**part.levels
            face[own] = local // children
            corners = corner_barycentrics(part.levels)[local % children]
            inside[own] = np.einsum("ni,nij->nj", barycentric[own], corners)
        return solid, face, inside


def drawn_mesh(scene: ScanScene, edge_m: float) -> DrawnMesh:
    """Split the solids of a scene until a typical edge is at most ``edge_m``.

    Stops earlier at two million triangles, of which every solid may have an equal share. With an
    infinite ``edge_m`` nothing is split, and stands (walls, floors) never are.
    """
    share = MAX_FACES / len(scene.solids)
    parts: list[Part] = []
    first_face = first_vertex = 0
    for solid in scene.solids:
        levels = 0 if solid.kind == "stand" else _levels(solid, edge_m, share / len(solid.faces))
        part = _part(solid, levels, first_face, first_vertex)
        parts.append(part)
        first_face += len(part.faces)
        first_vertex += len(part.source)
    return DrawnMesh(
        parts=tuple(parts),
        vertices=np.concatenate([p.points[p.source] for p in parts]),
        normals=np.concatenate([_normals(p) for p in parts]),
        faces=np.concatenate([_faces(p) for p in parts]),
        solid_of_face=np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts]),
    )


def typical_edge(points: Array, faces: Ids) -> float:
    """Return an edge length that 90 % of the triangles do not exceed, metres.

    That of the equilateral triangle of the same area, or 0.6 of the longest side where triangles
    are slivers.
    """
    area = 0.5 * np.linalg.norm(face_cross(points, faces), axis=1)
    sides = points[faces] - points[np.roll(faces, -1, axis=1)]
    longest = np.sqrt(np.einsum("fkj,fkj->fk", sides, sides).max(axis=1))
    edge = np.maximum(np.sqrt(area * 4 / np.sqrt(3)), 0.6 * longest)
    return float(np.quantile(edge, 0.9))


def _levels(solid: Solid, edge_m: float, room: float) -> int:
    edge = typical_edge(solid.vertices, solid.faces)
    wanted = int(np.ceil(np.log2(max(edge / edge_m, 1.0))))
    return min(wanted, _MAX_LEVELS, max(0, int(np.log(max(room, 1.0)) / np.log(4.0))))


def _part(solid: Solid, levels: int, first_face: int, first_vertex: int) -> Part:
    faces, n = solid.faces, len(solid.vertices)
    pairs = []
    for _ in range(levels):
        ends, faces = _split(faces, n)
        pairs.append(ends)
        n += len(ends)
    points = solid.vertices
    for ends in pairs:
        points = np.concatenate([points, points[ends].mean(axis=1)])
    source = np.arange(n) if solid.normals is not None else faces.ravel()
    return Part(solid, levels, faces, points, tuple(pairs), first_face, first_vertex, source)


def _split(faces: Ids, n: int) -> tuple[Ids, Ids]:
    """Split every triangle in four: ends of the new vertices (m, 2), children by parent."""
    half = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    low, high = half.min(axis=1), half.max(axis=1)
    keys, inverse = np.unique(low * n + high, return_inverse=True)
    ends = np.stack([keys // n, keys % n], axis=1)
    a, b, c = faces.T
    ab, bc, ca = (n + inverse.reshape(-1, 3)).T
    children = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1)
    return ends, children.reshape(-1, 3)


def corner_barycentrics(levels: int) -> Array:
    """Return where the corners of each child lie in its parent, (4**levels, 3, 3)."""
    corners = np.eye(3)[None]
    for _ in range(levels):
        corners = np.einsum("dij,cjk->cdik", CHILDREN, corners).reshape(-1, 3, 3)
    return corners


def _faces(part: Part) -> Ids:
    if part.solid.normals is None:
        return part.first_vertex + np.arange(3 * len(part.faces)).reshape(-1, 3)
    return part.first_vertex + part.faces


def _normals(part: Part) -> Array:
    if part.solid.normals is None:
        return np.repeat(unit(face_cross(part.points, part.faces)), 3, axis=0)
    return unit(part.spread(part.solid.normals))
