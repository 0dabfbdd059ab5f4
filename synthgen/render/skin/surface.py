"""Gloss of one person's skin, and its height map in one pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.render.skin.bake import SkinMaps
from synthgen.scene import Skin

Values = NDArray[np.float32]


def gloss(maps: SkinMaps, skin: Skin) -> tuple[Values, Values]:
    """Return roughness and clear coat, (size, size, 1) each.

    Palms are a little smoother than backs, sweat lies in patches, nails shine.
    """
    sweat = np.float32(skin.sweat)
    rough = np.float32(skin.roughness) - 0.05 * maps.palm + 0.025 * maps.middle
    rough += 0.06 * maps.tint + 0.03 * maps.cell - 0.12 * sweat
    wet = np.clip(0.45 + 0.25 * maps.big, 0, 1) * (0.35 + 0.65 * maps.palm)
    coat = 0.6 * sweat * wet
    free = np.clip((maps.nail_along - 0.85) / 0.05, 0, 1)
    painted = skin.varnish_rgb is not None
    nail = 0.18 if painted else 0.30 + 0.10 * free
    rough += maps.plate * (nail - rough)
    coat += maps.plate * ((0.8 if painted else 0.28) - coat)
    pair = (np.clip(rough, 0.15, 0.95), np.clip(coat, 0, 1))
    a, b = (np.asarray(v, np.float32)[maps.fill][..., None] for v in pair)
    return a, b


def height_m(maps: SkinMaps, skin: Skin, flexion_rad: NDArray[np.float64]) -> Values:
    """Return the height map (size, size, 1), metres.

    Parameters
    ----------
    maps : SkinMaps
    skin : Skin
    flexion_rad : (16,)
        How far each joint is bent towards the palm: wrinkles over a bent joint flatten, folds on
        its palm side and lines of the palm deepen.
    """
    bent = np.asarray(flexion_rad, dtype=np.float64)
    loose = np.clip(1.0 - bent / 0.9, 0.08, 1.25).astype(np.float32)
    folded = np.clip(0.75 + bent / 1.0, 0.5, 1.9).astype(np.float32)
    palm = np.float32(np.clip(0.9 + 0.6 * bent[[1, 4, 7, 10]].mean(), 0.6, 1.5))
    height = maps.wrinkles * loose[maps.joint] + maps.folds * folded[maps.joint]
    height += palm * maps.lines
    height *= np.float32(skin.creases)
    height += maps.still
    return np.asarray((1e-3 * height)[maps.fill][..., None], dtype=np.float32)
