"""A texture map of a scan: the crops of the colour pictures that its faces use, side by side.

Unwrapping a raw scan costs minutes; a projective atlas costs nothing and keeps the pictures' own
pixels. Where neighbouring faces use different pictures there is a seam, as on real scans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.scanner.colour import UNSEEN, Coloured, ColourView, Picture


@dataclass(frozen=True, eq=False)
class Atlas:
    """A texture map: the crops of the pictures that the faces use, side by side.

    Attributes
    ----------
    texture : (H, W, 3) uint8 sRGB
        Row 0 is the top.
    uv : (V, 2) float32
        Each vertex in the crop of its own view; origin bottom left. A face whose corners chose
        different views needs ``corner_uv``.
    corner_uv : (F, 3, 2) float32
        Per corner, all three in the crop of the face's view.
    face_view : (F,) int16
        View of each face, -1 where none sees it (its corners lie on a grey patch).
    """

    texture: Picture
    uv: NDArray[np.float32]
    corner_uv: NDArray[np.float32]
    face_view: NDArray[np.int16]


def build_atlas(coloured: Coloured, faces: NDArray[np.int64], views: Sequence[ColourView]) -> Atlas:
    """Give each face the view that its worst corner faces best, and pack the views' crops."""
    if not views:
        grey = np.full((8, 8, 3), UNSEEN, np.uint8)
        none = np.full(len(faces), -1, np.int16)
        middle = np.full((len(faces), 3, 2), 0.5, np.float32)
        return Atlas(grey, np.full((len(coloured.view), 2), 0.5, np.float32), middle, none)
    worst = coloured.facing[faces].min(axis=1)
    face_view = np.where(worst.max(axis=1) > 0, worst.argmax(axis=1), -1).astype(np.int16)
    boxes = [_box(coloured, faces, face_view, k, view) for k, view in enumerate(views)]
    places, size = _shelves([(b[2] - b[0], b[3] - b[1]) for b in boxes])
    texture = np.full((size[1], size[0], 3), UNSEEN, np.uint8)
    corner_uv = np.zeros((len(faces), 3, 2), np.float32)
    corner_uv[:] = [4, 4]  # the grey patch
    uv = np.full((len(coloured.view), 2), 4, np.float32)
    for k, (view, box, place) in enumerate(zip(views, boxes, places, strict=True)):
        left, top, right, bottom = box
        crop = view.picture[top:bottom, left:right]
        texture[place[1] : place[1] + crop.shape[0], place[0] : place[0] + crop.shape[1]] = crop
        shift = np.array([place[0] - left, place[1] - top], np.float32)
        own = face_view == k
        corner_uv[own] = coloured.pixels[faces[own], k] + shift
        mine = coloured.view == k
        uv[mine] = coloured.pixels[mine, k] + shift
    return Atlas(texture, _to_uv(uv, size), _to_uv(corner_uv, size), face_view)


def _box(
    coloured: Coloured, faces: NDArray[np.int64], face_view: NDArray[np.int16], k: int,
    view: ColourView,
) -> tuple[int, int, int, int]:  # fmt: skip
    """Left, top, right, bottom of what a view gives, two pixels wider."""
    used = np.concatenate([faces[face_view == k].ravel(), np.flatnonzero(coloured.view == k)])
    if not len(used):
        return 0, 0, 1, 1
    at = coloured.pixels[used, k]
    height, width = view.picture.shape[:2]
    left, top = np.maximum(np.floor(at.min(axis=0)).astype(int) - 2, 0)
    right, bottom = np.minimum(np.ceil(at.max(axis=0)).astype(int) + 3, [width, height])
    return int(left), int(top), int(right), int(bottom)


def _shelves(sizes: list[tuple[int, int]]) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Places (x, y) of rectangles in rows, tallest first, below an 8 pixel grey strip."""
    area = sum(w * h for w, h in sizes)
    width = max(max(w for w, _ in sizes), int(np.ceil(np.sqrt(area * 1.15))))
    places: list[tuple[int, int]] = [(0, 0)] * len(sizes)
    x, y, tall = 0, 8, 0
    for k in sorted(range(len(sizes)), key=lambda k: (-sizes[k][1], k)):
        w, h = sizes[k]
        if x + w > width:
            x, y, tall = 0, y + tall, 0
        places[k] = (x, y)
        x, tall = x + w, max(tall, h)
    return places, (width, y + tall)


def _to_uv(pixels: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    scaled = (pixels + 0.5) / np.array(size, np.float32)
    return np.stack([scaled[..., 0], 1 - scaled[..., 1]], axis=-1).astype(np.float32)
