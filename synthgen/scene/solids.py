"""Meshes of the things in a scene: boxes with rounded edges, and turned bodies.

Every box has the same topology, and so has every turned body: a renderer keeps slots for them and
moves vertices alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import unit
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.scene.description import Thing

Array = NDArray[np.float64]

SEGMENTS = 28
PROFILE = 16
BEVEL_M = 0.004


@dataclass(frozen=True, eq=False)
class SolidMesh:
    """A closed mesh.

    ``vertices`` (V, 3) world, metres; ``triangles`` (F, 3); ``normals`` (V, 3) unit, outwards;
    ``uv`` (V, 2) in [0, 1].
    """

    vertices: Array
    triangles: NDArray[np.int64]
    normals: Array
    uv: Array


def mesh_of(thing: Thing) -> SolidMesh:
    """Return a thing's mesh, world, metres."""
    local = _box(thing.size_m) if thing.shape == "box" else _turned(thing)
    rotation = matrix_from_axis_angle(np.array(thing.turn))
    vertices = local.vertices @ rotation.T + np.array(thing.position_m)
    return SolidMesh(vertices, local.triangles, local.normals @ rotation.T, local.uv)


# A box: its faces inset by the bevel; edges and corners join faces, and smooth normals round them.
_AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _box_corners() -> tuple[Array, Array, Array, Array]:
    """Signs, normals, bevelled axes and uv of the 24 vertices, four per face."""
    signs, normals, uv = [], [], []
    for axis, a, b in _AXES:
        for side in (1.0, -1.0):
            for p, q in _SQUARE if side > 0 else reversed(_SQUARE):
                sign, normal = np.zeros(3), np.zeros(3)
                sign[[axis, a, b]] = side, p, q
                normal[axis] = side
                signs.append(sign)
                normals.append(normal)
                uv.append(((p + 1) / 2, (q + 1) / 2))
    inset = 1 - np.abs(np.array(normals))
    return np.array(signs), np.array(normals), inset, np.array(uv)


_SIGNS, _NORMALS, _INSET, _BOX_UV = _box_corners()


def _box_triangles() -> NDArray[np.int64]:
    triangles = [4 * f + np.array(t) for f in range(6) for t in ((0, 1, 2), (0, 2, 3))]
    at: dict[tuple[float, ...], list[int]] = {}
    for k, sign in enumerate(_SIGNS):
        at.setdefault(tuple(sign), []).append(k)
    corners = [_outward(np.array(group)) for group in at.values()]
    edges = []
    for one, first in at.items():
        for other, second in at.items():
            if one < other and np.sum(np.array(one) != np.array(other)) == 1:
                edges += _edge(first, second)
    return np.array(triangles + corners + edges)


def _edge(first: list[int], second: list[int]) -> list[NDArray[np.int64]]:
    """Two triangles between the two faces that meet along the edge from one corner to another."""
    a, b = [(k, j) for k in first for j in second if np.array_equal(_NORMALS[k], _NORMALS[j])]
    return [_outward(np.array([a[0], a[1], b[1]])), _outward(np.array([a[0], b[1], b[0]]))]


def _outward(triangle: NDArray[np.int64]) -> NDArray[np.int64]:
    points = _SIGNS[triangle] - 0.1 * _INSET[triangle] * _SIGNS[triangle]
    cross = np.cross(points[1] - points[0], points[2] - points[0])
    return triangle if cross @ points.mean(axis=0) > 0 else triangle[::-1]


BOX_TRIANGLES = _box_triangles()
BOX_VERTICES = len(_SIGNS)


def _box(size_m: tuple[float, float, float]) -> SolidMesh:
    half = np.array(size_m) / 2
    bevel = min(BEVEL_M, 0.3 * half.min())
    return SolidMesh(_SIGNS * (half - bevel * _INSET), BOX_TRIANGLES, _NORMALS, _BOX_UV)


# Half profiles (radius, height) of turned bodies in a unit cube; a repeated point is a sharp rim.
_BALL = np.linspace(-np.pi / 2, np.pi / 2, PROFILE)
_PROFILES: dict[str, Array] = {
    "cylinder": np.array(
        [(0, -0.5), (0.48, -0.5), (0.5, -0.48), (0.5, -0.48), (0.5, 0.48), (0.5, 0.48),
         (0.48, 0.5), (0.48, 0.5), (0, 0.5)]
    ),
    "ball": 0.5 * np.stack([np.cos(_BALL), np.sin(_BALL)], axis=1),
    "bottle": np.array(
        [(0, -0.5), (0.46, -0.5), (0.5, -0.47), (0.5, -0.2), (0.5, 0.08), (0.46, 0.16),
         (0.34, 0.24), (0.2, 0.3), (0.17, 0.36), (0.17, 0.46), (0.2, 0.46), (0.2, 0.5),
         (0.2, 0.5), (0, 0.5)]
    ),
    "bowl": np.array(
        [(0, -0.5), (0.28, -0.5), (0.3, -0.46), (0.3, -0.46), (0.42, -0.2), (0.48, 0.2),
         (0.5, 0.5), (0.48, 0.5), (0.46, 0.2), (0.4, -0.16), (0.26, -0.4), (0, -0.42)]
    ),
    "cone": np.array([(0, -0.5), (0.5, -0.5), (0.5, -0.5), (0.05, 0.5), (0, 0.5)]),
}  # fmt: skip


def grid_triangles(rows: int, columns: int) -> NDArray[np.int64]:
    """Triangles of a grid of vertices, counter-clockwise where columns run right and rows up."""
    ids = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1]
    first = np.stack([a, b, c], axis=-1).reshape(-1, 3)
    return np.concatenate([first, np.stack([a, c, d], axis=-1).reshape(-1, 3)])


TURNED_TRIANGLES = grid_triangles(PROFILE, SEGMENTS + 1)[:, ::-1]
TURNED_VERTICES = PROFILE * (SEGMENTS + 1)


def _turned(thing: Thing) -> SolidMesh:
    given = _PROFILES[thing.shape]
    profile = np.concatenate([given, np.tile(given[-1:], (PROFILE - len(given), 1))])
    slope = _profile_normals(profile)
    angle = 2 * np.pi * np.arange(SEGMENTS + 1) / SEGMENTS
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    size = np.array(thing.size_m)
    unit_cube, normals = _spin(profile, around), _spin(slope, around)
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))]
    v, u = np.meshgrid(length / length[-1], angle / (2 * np.pi), indexing="ij")
    return SolidMesh(
        vertices=unit_cube * size,
        triangles=TURNED_TRIANGLES,
        normals=unit(normals / size),
        uv=np.stack([u.ravel(), v.ravel()], axis=1),
    )


def _spin(profile: Array, around: Array) -> Array:
    radius, height = profile[:, :1], profile[:, 1:]
    ring = np.stack(
        [radius * around[:, 0], np.broadcast_to(height, (len(profile), len(around))),
         radius * around[:, 1]], axis=-1,
    )  # fmt: skip
    return ring.reshape(-1, 3)


def _profile_normals(profile: Array) -> Array:
    """Return a profile's normals; at a repeated point each copy takes the side that it ends."""
    step = np.diff(profile, axis=0)
    across = np.stack([step[:, 1], -step[:, 0]], axis=1)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.divide(across, length, out=np.zeros_like(across), where=length > 1e-9)
    total = np.concatenate([across, np.zeros((1, 2))]) + np.concatenate([np.zeros((1, 2)), across])
    still = np.linalg.norm(total, axis=1) < 1e-6
    total[still] = [0.0, 1.0]
    return unit(total)
