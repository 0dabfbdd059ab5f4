"""Texture atlas, nail and palm masks of the hand and arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from synthgen.cc0.hand import HandCut
from synthgen.cc0.source import MakeHuman
from synthgen.geometry.normals import unit, vertex_normals

Array = NDArray[np.float64]
# Boxes (left, bottom, right, top) of the atlas.
_HAND_BOX, _ARM_BOX = (0.01, 0.01, 0.80, 0.99), (0.82, 0.01, 0.99, 0.99)


def pack_atlas(source: MakeHuman, cut: HandCut) -> tuple[Array, NDArray[np.int64]]:
    """Give the hand's island most of the square and the arm's islands the rest.

    Returns
    -------
    uv : (U, 2)
    uv_faces : (F, 3) int64
        Parallel to ``cut.triangles``.
    """
    ids, faces = np.unique(cut.texture, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int64)
    uv = source.texture[ids].copy()
    island = _islands(faces, len(ids))
    hand = np.unique(island[faces[: cut.n_hand_faces]])
    of_hand = np.isin(island, hand)
    uv[of_hand] = _fit(uv[of_hand], _HAND_BOX)
    others = [k for k in np.unique(island) if k not in hand]
    left, bottom, right, top = _ARM_BOX
    height = (top - bottom) / max(len(others), 1)
    for row, k in enumerate(others):
        low = bottom + row * height
        uv[island == k] = _fit(uv[island == k], (left, low, right, low + 0.97 * height))
    return uv, faces


def _islands(faces: NDArray[np.int64], n: int) -> NDArray[np.int32]:
    rows, columns = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    graph = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), (n, n))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1])


def _fit(uv: Array, box: tuple[float, float, float, float]) -> Array:
    """Scale an island evenly into a box, turned by 90 degrees where that makes it larger."""
    low, span = uv.min(axis=0), np.ptp(uv, axis=0)
    room = np.array([box[2] - box[0], box[3] - box[1]])
    local = uv - low
    if (room / span[::-1]).min() > (room / span).min():
        local = np.stack([span[1] - local[:, 1], local[:, 0]], axis=1)  # a turn, no mirror
        span = span[::-1]
    return np.asarray(local * (room / span).min() + [box[0], box[1]])


def nail_mask(source: MakeHuman, cut: HandCut) -> Array:
    """Sample MakeHuman's fingernail texture at the hand's vertices: (S,) in 0..1."""
    image = source.image("mpfb2/textures/mpfb_fingernails.jpg")[..., 0] / 255.0
    texture = np.zeros(len(cut.ids), dtype=np.int64)
    texture[cut.triangles.ravel()] = cut.texture.ravel()
    uv = source.texture[texture]
    size = np.array(image.shape)
    rows = np.clip(((1 - uv[:, 1]) * size[0]).astype(int), 0, size[0] - 1)
    columns = np.clip((uv[:, 0] * size[1]).astype(int), 0, size[1] - 1)
    mask = np.clip((image[rows, columns] - 0.25) / 0.4, 0, 1)
    mask[cut.n_hand :] = 0
    return np.asarray(mask)


def thumb_back(points: Array, faces: NDArray[np.int64], nail: Array, weights: Array) -> Array:
    """Mean normal of the thumb's nail: the direction out of the thumb's back."""
    own = (weights[:, 15] > 0.5) & (nail > 0.5)
    return unit(vertex_normals(points, faces)[own].mean(axis=0))


def palm_mask(
    points: Array, faces: NDArray[np.int64], weights: Array, joints: Array, back: Array
) -> Array:
    """Palm side of hand and arm, (S,) in 0..1, fading into the inner forearm."""
    normals = vertex_normals(points, faces)
    thumb = weights[:, 14:16].sum(axis=1)[:, None]
    out = unit((1 - thumb) * np.array([0.0, 1.0, 0.0]) + thumb * back)
    facing = np.sum(normals * out, axis=1)
    mask = np.clip(0.42 - 1.6 * facing, 0, 1)
    fade = np.clip(1 - (points[:, 0] - joints[0, 0]) / 0.03, 0, 1)
    return np.asarray(mask * fade)
