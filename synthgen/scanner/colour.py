"""Colours of a scan: every vertex from the best colour picture that sees it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, project
from synthgen.geometry.normals import unit
from synthgen.render import backend
from synthgen.scanner.glass import seen_position
from synthgen.scanner.rig import Glass

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
LEAST_FACING = 0.15
UNSEEN = 128
_LIFT_M = 0.0008


@dataclass(frozen=True, eq=False)
class ColourView:
    """A colour picture (H, W, 3) uint8 sRGB with the camera that is believed to have taken it.

    ``glass`` is what the camera may have looked through.
    """

    camera: Camera
    picture: Picture
    glass: Glass | None = None


@dataclass(frozen=True, eq=False)
class Coloured:
    """Colours of a mesh.

    Attributes
    ----------
    colors : (V, 3) uint8
        sRGB; grey 128 where no picture sees the vertex.
    view : (V,) int16
        Index into the views; -1 where none sees it.
    facing : (V, n) float32
        Cosine between the vertex normal and the line to each view, 0 where it is hidden.
    pixels : (V, n, 2) float32
        Where each view has the vertex.
    """

    colors: NDArray[np.uint8]
    view: NDArray[np.int16]
    facing: NDArray[np.float32]
    pixels: NDArray[np.float32]


def colour_vertices(
    vertices: Array, normals: Array, faces: NDArray[np.int64], views: Sequence[ColourView]
) -> Coloured:
    """Colour vertices (V, 3) by the picture that faces them most squarely and is not blocked.

    Occlusion is judged by the scan itself, as a scanner must: rays from the vertices to each
    camera against the fused mesh.
    """
    n = len(vertices)
    facing = np.zeros((n, len(views)), np.float32)
    pixels = np.zeros((n, len(views), 2), np.float32)
    blocked = _Blocker(vertices, faces)
    for k, view in enumerate(views):
        eyes = seen_position(view.glass, view.camera.position, vertices)
        at, z = project(view.camera, vertices - eyes + view.camera.position)
        pixels[:, k] = at
        sight = unit(eyes - vertices)
        cosine = np.einsum("vk,vk->v", normals, sight)
        height, width = view.picture.shape[:2]
        inside = (z > 0) & (at >= 0).all(axis=1) & (at <= [width - 1, height - 1]).all(axis=1)
        seen = inside & (cosine > LEAST_FACING)
        seen[seen] &= ~blocked(vertices[seen] + _LIFT_M * normals[seen], eyes[seen])
        facing[:, k] = np.where(seen, cosine, 0)
    best = facing.argmax(axis=1) if len(views) else np.zeros(n, np.int64)
    found = facing.max(axis=1, initial=0) > 0
    colors = np.full((n, 3), UNSEEN, np.uint8)
    for k, view in enumerate(views):
        own = found & (best == k)
        colors[own] = sample(view.picture, pixels[own, k])
    return Coloured(colors, np.where(found, best, -1).astype(np.int16), facing, pixels)


def sample(picture: Picture, at: NDArray[Any]) -> Picture:
    """Bilinear colours (n, 3) at pixels (n, 2)."""
    height, width = picture.shape[:2]
    corner = np.clip(np.floor(at).astype(np.int64), 0, [width - 2, height - 2])
    (x, y), (tx, ty) = corner.T, np.clip(at - corner, 0, 1).T[:, :, None]
    top = picture[y, x] * (1 - tx) + picture[y, x + 1] * tx
    bottom = picture[y + 1, x] * (1 - tx) + picture[y + 1, x + 1] * tx
    return np.asarray(np.rint(top * (1 - ty) + bottom * ty), np.uint8)


class _Blocker:
    """Answers whether a mesh lies between points and eyes, (n, 3) each."""

    def __init__(self, vertices: Array, faces: NDArray[np.int64]) -> None:
        backend.activate()
        mi: Any = backend.mitsuba()
        mesh = mi.Mesh("scan", len(vertices), len(faces))
        params = mi.traverse(mesh)
        params["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
        params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
        params.update()
        self.scene = mi.load_dict({"type": "scene", "mesh": mesh})

    def __call__(self, points: Array, eyes: Array) -> NDArray[np.bool_]:
        if not len(points):
            return np.zeros(0, dtype=bool)
        mi: Any = backend.mitsuba()
        away = eyes - points
        far = np.linalg.norm(away, axis=1)
        origin = mi.Point3f(*(mi.Float(v) for v in points.T.astype(np.float32)))
        direction = mi.Vector3f(*(mi.Float(v) for v in (away / far[:, None]).T.astype(np.float32)))
        ray = mi.Ray3f(origin, direction)
        ray.maxt = mi.Float(far.astype(np.float32))
        return np.array(self.scene.ray_test(ray))
