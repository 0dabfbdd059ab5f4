"""Plain skin: an albedo baked into the hand's atlas from masks and solid noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from synthgen.geometry.cameras import camera_from_K
from synthgen.geometry.raster import rasterise
from synthgen.models import ManoModel
from synthgen.sampling.streams import stream
from synthgen.scene import Skin
from synthgen.scene.transfer import masks_of

Array = NDArray[np.float64]
Image = NDArray[np.float32]

TEXTURE_PX = 512
_NOISE_CELLS = 32
_NOISE_CELL_M = 0.006


@dataclass(frozen=True, eq=False)
class PlainMaps:
    """Per texel of one topology's atlas: masks and rest position; texels outside are filled.

    ``palm``, ``nail``, ``knuckle`` (n, n) in 0..1; ``position`` (n, n, 3) metres.
    """

    palm: Array
    nail: Array
    knuckle: Array
    position: Array


@lru_cache(maxsize=8)
def maps_of(model: ManoModel) -> PlainMaps:
    """Rasterise masks and rest positions of a model into its atlas, once per process."""
    surface = model.surface
    points = np.concatenate([model.v_template, surface.arm.template])
    face, barycentric = _raster_atlas(surface.uv, surface.uv_faces)
    valid = face >= 0
    near = ndimage.distance_transform_edt(~valid, return_distances=False, return_indices=True)

    def spread(values: Array) -> Array:
        corners = values[surface.faces[np.maximum(face, 0)]]
        image = np.einsum("hwk,hwk...->hw...", barycentric, corners)
        return np.asarray(image[near[0], near[1]])

    palm, nail = masks_of(model)
    return PlainMaps(
        palm=spread(palm),
        nail=spread(nail),
        knuckle=spread(_knuckles(model, len(points))),
        position=spread(points),
    )


def _raster_atlas(uv: Array, uv_faces: NDArray[np.int64]) -> tuple[NDArray[np.int32], Array]:
    """Draw the atlas as a flat picture, one texel per pixel, v upwards."""
    n = TEXTURE_PX
    flat = np.concatenate([uv[:, :1], 1 - uv[:, 1:], np.ones((len(uv), 1))], axis=1)
    K = np.array([[n, 0, -0.5], [0, n, -0.5], [0, 0, 1]], dtype=np.float64)
    face, barycentric, _ = rasterise(flat, uv_faces, camera_from_K(K, n, n))
    return face, barycentric


def _knuckles(model: ManoModel, n_surface: int) -> Array:
    """Where two phalanges share the skin: 1 at the joints, 0 along the bones."""
    w = model.weights
    pairs = [(j, int(p)) for j, p in enumerate(model.parents) if p >= 0]
    shared = np.max([4 * w[:, j] * w[:, p] for j, p in pairs], axis=0)
    result = np.zeros(n_surface)
    result[: len(shared)] = shared
    return result


@lru_cache(maxsize=16)
def bake(model: ManoModel, skin: Skin) -> Image:
    """Return the albedo (n, n, 3) float32, linear, first row at v = 1."""
    maps = maps_of(model)
    dorsal, palm, nail = (np.array(c) for c in (skin.dorsal_rgb, skin.palm_rgb, skin.nail_rgb))
    albedo = dorsal + maps.palm[..., None] * (palm - dorsal)
    redness = 0.14 * maps.knuckle * (1 - 0.5 * maps.palm)
    albedo = albedo * (1 - redness[..., None] * [0.5, 1.0, 0.9])
    albedo = albedo * (1 + skin.mottle * _mottle(maps.position, skin.seed))
    albedo = albedo + maps.nail[..., None] * (nail - albedo)
    return np.asarray(np.clip(albedo, 0.004, 0.95), dtype=np.float32)


def _mottle(position: Array, seed: int) -> Array:
    """Solid noise (n, n, 3) at 6 and 18 mm: lightness, and a little red against blue."""
    rng = stream(seed, "subject", 0, 0, "mottle")
    volume = rng.standard_normal((2, *[_NOISE_CELLS] * 3))
    fine = _sample(volume[0], position / _NOISE_CELL_M)
    coarse = _sample(volume[1], position / (3 * _NOISE_CELL_M))
    light = 0.6 * fine + coarse
    return np.stack([light - 0.3 * coarse, light + 0.2 * coarse, light], axis=-1)


def _sample(volume: Array, where: Array) -> Array:
    coordinates = where.reshape(-1, 3).T
    values = ndimage.map_coordinates(volume, coordinates, order=1, mode="grid-wrap")
    return np.asarray(values.reshape(where.shape[:-1]))
