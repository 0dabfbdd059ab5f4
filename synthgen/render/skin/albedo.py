"""One person's albedo from the baked maps: pigments per texel, then colour by a table."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.render.skin.bake import SkinMaps
from synthgen.render.skin.fields import FRECKLE_SITES
from synthgen.sampling.appearance import pigments_of
from synthgen.sampling.colour import linear_rgb_from_xyz
from synthgen.sampling.spectrum import bands, skin_xyz
from synthgen.sampling.streams import stream
from synthgen.scene import Skin

Values = NDArray[np.float32]

# Logarithms of the pigments that the colour table spans, and its coarse and fine sizes.
_MELANIN = (float(np.log(0.0015)), float(np.log(0.7)))
_BLOOD = (float(np.log(0.002)), float(np.log(0.25)))
_COARSE, _FINE = (96, 28), (512, 168)
_VEIN_TINT = np.array([-0.15, -0.05, 0.02], dtype=np.float32)


def albedo(maps: SkinMaps, skin: Skin) -> Values:
    """Return the albedo (size, size, 3) float32, linear sRGB, first row at v = 1."""
    melanin, blood = _pigments(maps, skin)
    index = _table_index(melanin, blood)
    colour = _table(skin, 0.0)[index]
    palm = np.flatnonzero(maps.palm > 0.01)
    horny = _table(skin, 2.0)[index[palm]]  # the thick horny layer of the palm is yellow
    colour[palm] += maps.palm[palm, None] * (horny - colour[palm])
    dark = min(1.0, skin.melanin / 0.15)
    shade = 1 - 0.11 * skin.creases * maps.tint
    shade *= 1 + (0.7 * skin.mottle * maps.fine - 0.05 * maps.cell) * (1 - maps.plate)
    colour *= shade[:, None]
    vein = maps.vein * np.float32(skin.veins * (1 - dark))
    colour *= 1 + vein[:, None] * _VEIN_TINT
    _paint_nails(colour, maps, skin, dark)
    return np.asarray(np.clip(colour, 0.004, 0.95), np.float32)[maps.fill]


def _pigments(maps: SkinMaps, skin: Skin) -> tuple[Values, Values]:
    """Logarithms of melanin and blood fractions per texel."""
    palm_melanin, palm_blood, _, _ = pigments_of(
        "palm", skin.melanin, skin.blood, skin.eumelanin, skin.carotene
    )
    dark, bare, m = min(1.0, skin.melanin / 0.06), 1 - maps.palm, skin.mottle
    deep = min(1.0, skin.melanin / 0.3)  # very dark skin has little left to darken
    melanin = np.float32(np.log(skin.melanin)) * bare + np.float32(np.log(palm_melanin)) * maps.palm
    even = 1 - 0.6 * deep
    melanin += np.float32(2.0 * m * even) * maps.pigment
    melanin += np.float32(1.4 * m * even) * maps.big * bare
    melanin += np.float32(np.log1p(0.42 * dark * (1 - 0.75 * deep))) * maps.knuckle
    melanin += np.float32(0.22 * dark) * maps.cuticle
    melanin += np.float32(np.log(0.80)) * maps.inner
    # Creases of dark palms hold pigment.
    melanin += np.float32(0.55 * dark * skin.creases) * maps.tint * maps.palm
    _add_freckles(melanin, maps, skin)
    blood = np.float32(np.log(skin.blood)) + np.float32(np.log(palm_blood / skin.blood)) * maps.palm
    blood += np.float32(2.2 * m) * maps.middle + np.float32(2.6 * m) * maps.big
    blood += np.float32(1.2 * m) * maps.fine
    blood += np.float32(0.40) * maps.knuckle + np.float32(0.38) * maps.tip * maps.palm
    blood += np.float32(0.30) * maps.pad - np.float32(0.12) * maps.palm * (1 - maps.pad)
    blood += (
        np.float32(0.35) * maps.tint * np.float32(skin.creases) + np.float32(0.3) * maps.cuticle
    )
    return melanin, blood


def _add_freckles(melanin: Values, maps: SkinMaps, skin: Skin) -> None:
    """Freckles, and a mole or two, at this person's share of the sites."""
    rng = stream(skin.seed, "subject", 0, 0, "freckles")
    taken = rng.random(FRECKLE_SITES) < skin.freckles
    radius = np.where(taken, rng.uniform(0.25, 1.0, FRECKLE_SITES), -9.0)
    strength = rng.uniform(0.15, 0.6, FRECKLE_SITES)
    moles = rng.permutation(FRECKLE_SITES)[: rng.integers(0, 3) * (skin.freckles > 0)]
    radius[moles], strength[moles] = rng.uniform(0.6, 1.1, len(moles)), 1.3
    near = np.flatnonzero((maps.freckle_mm < 1.6) & (radius[maps.freckle] > 0))
    site = maps.freckle[near]
    inside = radius[site] - maps.freckle_mm[near] + 0.12 * maps.fine[near]
    spot = np.clip(inside / 0.5 + 0.5, 0, 1) * (1 - maps.palm[near]) * (1 - maps.plate[near])
    melanin[near] += (np.log1p(3.0 * strength[site]) * spot).astype(np.float32)


def _table_index(melanin: Values, blood: Values) -> NDArray[np.int32]:
    rows = (melanin - _MELANIN[0]) * ((_FINE[0] - 1) / (_MELANIN[1] - _MELANIN[0])) + 0.5
    columns = (blood - _BLOOD[0]) * ((_FINE[1] - 1) / (_BLOOD[1] - _BLOOD[0])) + 0.5
    i = np.clip(rows, 0, _FINE[0] - 1).astype(np.int32)
    j = np.clip(columns, 0, _FINE[1] - 1).astype(np.int32)
    return np.asarray(i * _FINE[1] + j)


def _table(skin: Skin, more_carotene: float) -> Values:
    """Colours (rows * columns, 3) over log melanin and log blood for one person."""
    melanin = np.exp(np.linspace(*_MELANIN, _COARSE[0]))[:, None]
    blood = np.exp(np.linspace(*_BLOOD, _COARSE[1]))[None]
    carotene = skin.carotene + more_carotene
    coarse = skin_xyz(melanin, blood, skin.eumelanin, carotene, bands(16))
    across = _stretch(_FINE[0], _COARSE[0]) @ linear_rgb_from_xyz(coarse).transpose(2, 0, 1)
    fine = (across @ _stretch(_FINE[1], _COARSE[1]).T).transpose(1, 2, 0)
    return np.asarray(fine, dtype=np.float32).reshape(-1, 3)


def _stretch(fine: int, coarse: int) -> NDArray[np.float64]:
    """Matrix (fine, coarse) of linear interpolation, ends on ends."""
    columns = np.arange(coarse)
    places = np.linspace(0, coarse - 1, fine)[:, None]
    return np.asarray(np.clip(1 - np.abs(places - columns), 0, 1))


def _paint_nails(colour: Values, maps: SkinMaps, skin: Skin, dark: float) -> None:
    """Bed, half-moon, free edge; and the fold of skin around them."""
    fold = np.flatnonzero(maps.cuticle > 0.01)
    colour[fold] *= 1 - maps.cuticle[fold, None] * np.array([0.22, 0.28, 0.28], np.float32)
    own = np.flatnonzero(maps.plate > 0.004)
    u, w = maps.nail_along[own], maps.nail_across[own]
    edge = 0.76 + 0.16 * stream(skin.seed, "subject", 0, 0, "nails").random() - 0.10 * w**2
    bed = np.array(skin.nail_rgb, np.float32) * (1 + 0.06 * maps.middle[own, None])
    bed *= 1 - 0.10 * np.clip(u + 0.2, 0, 1)[:, None] * np.array([0.2, 1.0, 1.0], np.float32)
    pale = 0.55 * bed + 0.45 * np.array([0.60, 0.53, 0.48], np.float32) * (1 - 0.45 * dark)
    bed = _mix(bed, pale, np.full(len(own), 0.10))  # the plate itself scatters a little
    moon = np.clip(1.5 - 1.5 * (((u + 1.0) / 0.40) ** 2 + (w / 0.62) ** 2), 0, 1)
    nail = _mix(bed, pale, 0.55 * moon)
    band = np.exp(-(((u - edge + 0.06) / 0.06) ** 2))
    nail *= 1 - 0.12 * band[:, None] * np.array([0.3, 1.0, 1.0], np.float32)
    free = np.array([0.56, 0.51, 0.44], np.float32) * (1 - 0.50 * dark)
    if skin.varnish_rgb is not None:
        paint = np.tile(np.array(skin.varnish_rgb, np.float32), (len(own), 1))
        bare = np.clip((u + 0.93) / 0.04 + 0.5, 0, 1) * np.clip((0.95 - np.abs(w)) / 0.04, 0, 1)
        colour[own] = _mix(colour[own], _mix(nail, paint, bare), maps.plate[own])
        return
    nail = _mix(nail, free, (0.65 - 0.2 * dark) * np.clip((u - edge) / 0.05 + 0.5, 0, 1))
    colour[own] = _mix(colour[own], nail, maps.plate[own])


def _mix(a: Any, b: Any, share: Any) -> Values:
    return np.asarray(a + np.asarray(share)[:, None] * (b - a), dtype=np.float32)
