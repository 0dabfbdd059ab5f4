"""Spectral reflectance of skin: a two-layer model from pigments to colour.

The epidermis absorbs (melanin), the dermis scatters and absorbs (blood, carotenes). Light passes
the epidermis twice; what comes back is ``R = Re + (1 - Re) T**2 Rd``. Coefficients after Jacques
(1998, "Skin Optics"), Donner & Jensen (2006); ``Rd`` is the diffuse reflectance of a half space
(Farrell 1992, as Jensen 2001); blood is flattened by its packing into vessels (van Veen 2002).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.sampling.colour import XYZ_WHITE, lab_from_xyz, linear_rgb_from_xyz

Array = NDArray[np.float64]

_TABLE = Path(__file__).parent / "data" / "skin_bands.csv"
_EPIDERMIS_CM = 0.010
_OBLIQUE = 1.7  # diffuse light crosses the epidermis at a slant
_VESSEL_RADIUS_CM = 0.0010
_OXYGENATION = 0.75
# (strength, centre nm, width nm) of carotene and bilirubin bands, 1/cm at carotene 1
_CAROTENE = ((1.6, 460.0, 32.0), (0.9, 425.0, 20.0), (0.9, 488.0, 14.0))
_INDEX_RATIO = (1 + 0.493) / (1 - 0.493)  # internal reflection at n = 1.4


@dataclass(frozen=True, eq=False)
class Bands:
    """Table of n bands: wavelengths, blood, and weights (n, 3) that turn reflectance into XYZ."""

    wavelength_nm: Array
    hbo2: Array
    hb: Array
    to_xyz: Array


@lru_cache(maxsize=4)
def bands(count: int = 31) -> Bands:
    """Return the shipped table: 31 bands of 10 nm, or 16 of 20 nm; white has Y = 1."""
    rows = np.loadtxt(_TABLE, delimiter=",", skiprows=5)[:: 30 // (count - 1)]
    weights = rows[:, 1:4] * rows[:, 4:5]
    # A perfect reflector is D65 white whatever the number of bands.
    return Bands(rows[:, 0], rows[:, 5], rows[:, 6], weights / weights.sum(axis=0) * XYZ_WHITE)


def reflectance(
    melanin: Any, blood: Any, eumelanin: Any, carotene: Any, table: Bands | None = None
) -> Array:
    """Return the diffuse reflectance (..., n) of skin.

    Parameters
    ----------
    melanin : (...) float
        Volume fraction of melanosomes in the epidermis, 0.002-0.5.
    blood : (...) float
        Volume fraction of blood in the dermis, 0.002-0.2.
    eumelanin : (...) float
        Share of eumelanin, the rest pheomelanin, 0..1.
    carotene : (...) float
        Strength of the carotene bands, about 0.5-4.
    table : Bands or None
        None takes 31 bands.
    """
    t = table or bands()
    nm = t.wavelength_nm
    mel, blood, eu, car = (np.asarray(v, np.float64)[..., None] for v in
                           (melanin, blood, eumelanin, carotene))  # fmt: skip
    base = 0.244 + 85.3 * np.exp(-(nm - 154) / 66.2)
    pigment = eu * 6.6e11 * nm**-3.33 + (1 - eu) * 2.9e15 * nm**-4.75
    epidermis = mel * pigment + (1 - mel) * base
    yellow = sum(a * np.exp(-(((nm - centre) / width) ** 2)) for a, centre, width in _CAROTENE)
    dermis = blood * _blood(t) + (1 - blood) * base + car * yellow
    scatter = 1.2 * 46 * (nm / 500) ** -1.42
    albedo = scatter / (scatter + dermis)
    root = np.sqrt(3 * (1 - albedo))
    deep = albedo / 2 * (1 + np.exp(-4 / 3 * _INDEX_RATIO * root)) * np.exp(-root)
    through = np.exp(-2 * _OBLIQUE * epidermis * _EPIDERMIS_CM)
    back = scatter / 4
    loss = epidermis + back
    # Light scattered back within the epidermis keeps very dark skin off black.
    early = back / (2 * loss) * (1 - np.exp(-2 * loss * _EPIDERMIS_CM))
    return np.asarray(early + (1 - early) * through * deep)


def _blood(t: Bands) -> Array:
    """Absorption of whole blood, 1/cm, as vessels of one radius show it."""
    whole = 2.303 * 150 / 64500 * (_OXYGENATION * t.hbo2 + (1 - _OXYGENATION) * t.hb)
    thickness = 2 * whole * _VESSEL_RADIUS_CM
    return np.asarray(whole * (1 - np.exp(-thickness)) / thickness)


def skin_xyz(
    melanin: Any, blood: Any, eumelanin: Any, carotene: Any, table: Bands | None = None
) -> Array:
    """Return XYZ (..., 3) under D65 of skin; parameters as :func:`reflectance`."""
    t = table or bands()
    return np.asarray(reflectance(melanin, blood, eumelanin, carotene, t) @ t.to_xyz)


def skin_rgb(melanin: Any, blood: Any, eumelanin: Any, carotene: Any) -> Array:
    """Return the albedo (..., 3), linear sRGB; parameters as :func:`reflectance`."""
    return linear_rgb_from_xyz(skin_xyz(melanin, blood, eumelanin, carotene))


def skin_lab(
    melanin: Any, blood: Any, eumelanin: Any, carotene: Any, table: Bands | None = None
) -> Array:
    """Return CIELAB (..., 3), D65; parameters as :func:`reflectance`."""
    return lab_from_xyz(skin_xyz(melanin, blood, eumelanin, carotene, table))
