"""A plain garment: short-sleeved shirt and shorts in one piece, cut from MakeHuman's tights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.foundation import Foundation
from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.subdivision import InterpolatingSubdivision
from synthgen.geometry.topology import boundary_loops

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SHIRT, SHORTS = (92, 112, 140), (52, 56, 66)
# Distance from the skin: of the cloth (wanted, at least) and of its hems, metres.
WANTED_M, CLEARANCE_M, HEM_M = 0.010, 0.007, 0.001
# Where sleeves and legs end, in shares of upper arm and thigh; the waist, of pelvis to spine1.
_SLEEVE, _LEG, _WAIST = 0.45, 0.55, 0.5
# The neckline: a ball about a place above and before the neck's joint, metres.
_NECK_RADIUS_M, _NECK_UP_M, _NECK_AHEAD_M = 0.10, 0.02, 0.015
# Vertices this near to a cut count as on it, metres.
_SNAP_M = 1.5e-3


def garment_mesh(base: Foundation) -> tuple[Array, Ints, Array, Ints, Array]:
    """Cut, fit and hem the garment.

    Returns
    -------
    points : (A, 3), faces : (Fa, 3)
    colour : (Fa, 3)
        Shirt above the waist, shorts below.
    bind_ids : (A, 3) int64, bind_weights : (A, 3)
        Skin beneath each vertex.
    """
    skin, skin_faces = base.template[: base.cut.n_body], base.cut.faces
    rows = base.cut.extras["tights"]
    quads = base.cut.quads["tights"]
    faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    finer = InterpolatingSubdivision.build(faces, len(rows), 1)
    points, faces = finer.apply(base.template[rows]), finer.faces
    points = _pushed_out(points, faces, skin, skin_faces)
    at = dict(zip(base.skeleton.names, base.joints, strict=True))
    for cut in (_beyond_sleeves, _below_legs, _at_neck):
        points, faces, _ = sliced(points, faces, cut(points, at))
    waist = at["pelvis"][1] + _WAIST * (at["spine1"] - at["pelvis"])[1]
    points, low, high = sliced(points, faces, points[:, 1] - waist)
    used, faces = np.unique(np.concatenate([low, high]), return_inverse=True)
    points, faces = points[used], faces.reshape(-1, 3).astype(np.int64)
    points = _off_skin(points, skin, skin_faces, CLEARANCE_M)
    colour = np.concatenate([np.tile(SHORTS, (len(low), 1)), np.tile(SHIRT, (len(high), 1))])
    points, faces, colour = _hemmed(points, faces, colour, skin, skin_faces)
    ids, share, _, _ = closest_skin(points, skin, skin_faces)
    return points, faces, colour, ids, share


def _beyond_sleeves(points: Array, at: dict[str, Array]) -> Array:
    end = at["left_shoulder"] + _SLEEVE * (at["left_elbow"] - at["left_shoulder"])
    return np.asarray(np.abs(points[:, 0]) - end[0])


def _below_legs(points: Array, at: dict[str, Array]) -> Array:
    end = at["left_hip"] + _LEG * (at["left_knee"] - at["left_hip"])
    return np.asarray(end[1] - points[:, 1])


def _at_neck(points: Array, at: dict[str, Array]) -> Array:
    middle = at["neck"] + [0, _NECK_UP_M, _NECK_AHEAD_M]
    ball = _NECK_RADIUS_M - np.linalg.norm(points - middle, axis=1)
    return np.asarray(np.maximum(ball, points[:, 1] - middle[1]))


def sliced(points: Array, faces: Ints, field: Array) -> tuple[Array, Ints, Ints]:
    """Cut triangles along field = 0; return points with the new ones, faces below and above."""
    field = np.where(np.abs(field) < _SNAP_M, 0.0, field)
    corner = field[faces]
    mixed = (corner.min(axis=1) < 0) & (corner.max(axis=1) > 0)
    extra: list[Array] = []
    middle: dict[tuple[int, int], int] = {}
    pieces: tuple[list[list[int]], list[list[int]]] = ([], [])
    for face in faces[mixed].tolist():
        loop: list[tuple[int, float]] = []
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            loop.append((a, float(field[a])))
            if field[a] * field[b] < 0:
                i, j = min(a, b), max(a, b)
                if (i, j) not in middle:
                    middle[i, j] = len(points) + len(extra)
                    t = field[i] / (field[i] - field[j])
                    extra.append(points[i] + t * (points[j] - points[i]))
                loop.append((middle[i, j], 0.0))
        for side, sign in zip(pieces, (-1.0, 1.0), strict=True):
            own = [k for k, level in loop if sign * level >= 0]
            side += [[own[0], own[i], own[i + 1]] for i in range(1, len(own) - 1)]
    low = faces[~mixed & (corner.min(axis=1) < 0)]
    high = faces[~mixed & (corner.min(axis=1) >= 0)]
    sides = [
        np.concatenate([whole, np.array(cut, dtype=np.int64).reshape(-1, 3)])
        for whole, cut in zip((low, high), pieces, strict=True)
    ]
    return np.concatenate([points, np.array(extra).reshape(-1, 3)]), sides[0], sides[1]


def _pushed_out(points: Array, faces: Ints, skin: Array, skin_faces: Ints) -> Array:
    """Keep the cloth off the skin, evened out over neighbours."""
    for _ in range(8):
        points = _off_skin(points, skin, skin_faces, WANTED_M)
        points = _smoothed(points, faces)
    return _off_skin(points, skin, skin_faces, CLEARANCE_M)


def _off_skin(points: Array, skin: Array, skin_faces: Ints, least: float) -> Array:
    _, _, foot, normal = closest_skin(points, skin, skin_faces)
    gap = np.sum((points - foot) * normal, axis=1)
    return np.asarray(points + np.maximum(least - gap, 0)[:, None] * normal)


def _smoothed(points: Array, faces: Ints) -> Array:
    """Half-way to the mean of the neighbours, hems kept."""
    total, count = np.zeros_like(points), np.zeros(len(points))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        for i, j in ((a, b), (b, a)):
            np.add.at(total, faces[:, i], points[faces[:, j]])
            np.add.at(count, faces[:, i], 1)
    result = 0.5 * points + 0.5 * total / count[:, None]
    for loop in boundary_loops(faces):
        result[loop] = points[loop]
    return result


def _hemmed(
    points: Array, faces: Ints, colour: Array, skin: Array, skin_faces: Ints
) -> tuple[Array, Ints, Array]:
    """Add a strip from every hem in to the skin, so that nobody looks under the cloth."""
    middle = points[faces].mean(axis=1)
    for loop in boundary_loops(faces):
        _, _, foot, normal = closest_skin(points[loop], skin, skin_faces)
        inner = len(points) + np.arange(len(loop))
        nearest = np.linalg.norm(middle - points[loop[0]], axis=1).argmin()
        points = np.concatenate([points, foot + HEM_M * normal])
        ahead, inner_ahead = np.roll(loop, -1), np.roll(inner, -1)
        strip = [
            np.stack([ahead, loop, inner], axis=1),
            np.stack([ahead, inner, inner_ahead], axis=1),
        ]
        faces = np.concatenate([faces, *strip])
        colour = np.concatenate([colour, np.tile(colour[nearest], (2 * len(loop), 1))])
    return points, faces, colour


def closest_skin(points: Array, skin: Array, faces: Ints) -> tuple[Ints, Array, Array, Array]:
    """Closest skin: vertex ids (n, 3), shares (n, 3), points (n, 3), smooth unit normals (n, 3)."""
    import igl

    _, face, foot = igl.point_mesh_squared_distance(points, skin, faces)[:3]
    ids = faces[face]
    a, b, c = (np.ascontiguousarray(skin[ids[:, k]]) for k in range(3))
    share = np.clip(igl.barycentric_coordinates(np.ascontiguousarray(foot), a, b, c), 0, 1)
    share /= share.sum(axis=1, keepdims=True)
    normal = np.einsum("nk,nkc->nc", share, vertex_normals(skin, faces)[ids])
    return ids, share, foot, normal / np.linalg.norm(normal, axis=1, keepdims=True)
