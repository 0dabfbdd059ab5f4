"""Eyes, lashes, teeth, tongue and a plain garment: separate meshes that follow the body."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.cc0.foundation import Foundation
from synthgen.cc0.garment import closest_skin, garment_mesh
from synthgen.cc0.packing import packed_weights
from synthgen.geometry.rotations import matrix_from_axis_angle

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Colour = tuple[int, int, int]

# Degrees from the middle of the pupil where rings of the eyeball's mesh lie, and colours between.
_RINGS = (0.0, 5.0, 9.5, 15.0, 22.0, 29.0, 38.0, 50.0, 65.0, 85.0, 110.0, 140.0, 180.0)
_SEGMENTS = 32
_PUPIL, _IRIS, _SCLERA = (18, 14, 12), (96, 66, 44), (236, 230, 224)
_PUPIL_DEG, _IRIS_DEG = 9.5, 29.0
_LASHES, _TEETH, _TONGUE = (30, 22, 18), (228, 220, 205), (178, 84, 82)
# Share of MakeHuman's lashes that is kept, from the lid outwards: they are one solid strip.
_LASH_LENGTH = 0.4
_LASH_ROOT_M = 5e-4
# The eyeballs look down to the middle of the lids' opening, degrees.
_GAZE_DEG = 5.0


def attachments(base: Foundation, expressions: Array | None) -> dict[str, Any]:
    """Pack every separate mesh; expressions (S, 3, n) of the cut's vertices, or None."""
    result: dict[str, Any] = {
        "attachments": np.array(["eyes", "lashes", "teeth", "tongue", "garment"])
    }
    result |= _eyes(base)
    for name, colour in (("lashes", _LASHES), ("teeth", _TEETH), ("tongue", _TONGUE)):
        rows, faces = base.cut.extras[name], _split(base.cut.quads[name])
        bases = [base.template[:, :, None], base.shapes]
        bases += [] if expressions is None else [expressions]
        own = [_shortened(base, b, rows) if name == "lashes" else b[rows] for b in bases]
        result |= _mesh(name, own[0][..., 0], faces, np.tile(colour, (len(faces), 1)))
        result[f"{name}_shapedirs"] = own[1].astype(np.float32)
        result |= packed_weights(base.weights[rows], f"{name}_")
        if expressions is not None:
            result[f"{name}_exprdirs"] = own[2].astype(np.float32)
    points, faces, colours, ids, share = garment_mesh(base)
    return {
        **result,
        **_mesh("garment", points, faces, colours),
        "garment_bind_ids": ids.astype(np.int32),
        "garment_bind_weights": share.astype(np.float32),
    }


def _shortened(base: Foundation, bases: Array, rows: Ints) -> Array:
    """Draw lashes (rows of bases (S, 3, n)) in towards their roots, which lie on the lids."""
    points = base.template[rows]
    foot = closest_skin(points, base.template[: base.cut.n_body], base.cut.faces)[2]
    away = np.linalg.norm(points - foot, axis=1)
    roots = np.flatnonzero(away < max(_LASH_ROOT_M, float(np.quantile(away, 0.35))))
    nearest = rows[roots[cKDTree(points[roots]).query(points)[1]]]
    return np.asarray(bases[nearest] + _LASH_LENGTH * (bases[rows] - bases[nearest]))


def _mesh(name: str, template: Array, faces: Ints, colour: Array) -> dict[str, Any]:
    return {
        f"{name}_template": template.astype(np.float32),
        f"{name}_f": faces.astype(np.uint32),
        f"{name}_colour": colour.astype(np.uint8),
    }


def _split(quads: Ints) -> Ints:
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _eyes(base: Foundation) -> dict[str, Any]:
    """Round eyeballs, fitted to MakeHuman's; centre and radius are linear in the betas."""
    directions, faces, angle = _ball()
    colour = np.array(_SCLERA)[None].repeat(len(faces), axis=0)
    colour[angle < _IRIS_DEG] = _IRIS
    colour[angle < _PUPIL_DEG] = _PUPIL
    rows = base.cut.extras["eyes"]
    templates, shapes, weights = [], [], []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        own = rows[base.template[rows, 0] * sign > 0]
        centre, radius = _sphere(base.template[own])
        out = (base.template[own] - centre) / len(own) / radius
        move = base.shapes[own].mean(axis=0)
        grow = np.einsum("vc,vcn->n", out, base.shapes[own])
        turned = directions @ _gaze().T * [sign, 1, 1]
        templates.append(centre + radius * turned)
        shapes.append(move + turned[:, :, None] * grow)
        table = np.zeros((len(turned), len(base.skeleton.names)))
        table[:, base.skeleton.nearest(f"{side}_eye")] = 1
        weights.append(table)
    both = np.concatenate([faces, faces[:, ::-1] + len(directions)])
    return {
        **_mesh("eyes", np.concatenate(templates), both, np.concatenate([colour, colour])),
        "eyes_shapedirs": np.concatenate(shapes).astype(np.float32),
        **packed_weights(np.concatenate(weights), "eyes_"),
    }


def _gaze() -> Array:
    return matrix_from_axis_angle(np.deg2rad([_GAZE_DEG, 0, 0]))


def _sphere(points: Array) -> tuple[Array, float]:
    """Least-squares sphere: centre and radius."""
    A = np.column_stack([2 * points, np.ones(len(points))])
    solved = np.linalg.lstsq(A, np.sum(points**2, axis=1), rcond=None)[0]
    return solved[:3], float(np.sqrt(solved[3] + solved[:3] @ solved[:3]))


def _ball() -> tuple[Array, Ints, Array]:
    """Return a unit sphere that looks along +z: vertices, faces, the faces' degrees from +z."""
    turn = 2 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    points = []
    for ring in np.deg2rad(_RINGS):
        x, y = np.sin(ring) * np.cos(turn), np.sin(ring) * np.sin(turn)
        points.append(np.stack([x, y, np.full(_SEGMENTS, np.cos(ring))], axis=1))
    faces, angle = [], []
    k = np.arange(_SEGMENTS)
    n = (k + 1) % _SEGMENTS
    last = len(_RINGS) - 2
    for r in range(last + 1):
        a, b = r * _SEGMENTS, (r + 1) * _SEGMENTS
        quads = np.stack([a + k, b + k, b + n, a + n], axis=1)
        # at the poles one half of each quad has no area
        halves = [quads[:, [0, 1, 2]]] * (r < last) + [quads[:, [0, 2, 3]]] * (r > 0)
        faces += halves
        angle += [0.5 * (_RINGS[r] + _RINGS[r + 1])] * (_SEGMENTS * len(halves))
    return np.concatenate(points), np.concatenate(faces), np.array(angle)
