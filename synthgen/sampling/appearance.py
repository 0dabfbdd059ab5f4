"""Appearance of a person's skin: pigments drawn so that tones are uniform in typology angle.

A tone is an individual typology angle (ITA): lightness against yellow, the measure in which
measured populations are reported. The melanin that gives the angle is solved for, with this
person's blood, carotene and kind of melanin; palms and nail beds keep little melanin.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from synthgen.config.skin import SkinSettings
from synthgen.sampling.colour import linear_rgb_from_lab, typology_angle
from synthgen.sampling.spectrum import skin_lab, skin_rgb
from synthgen.scene import Skin
from synthgen.scene.description import Vec3

__all__ = ["linear_rgb_from_lab", "pigments_of", "rounded", "sample_skin", "switched"]

# ITA of tone 0 and tone 1: the human range from very light to very dark.
ITA_DEG = (60.0, -66.0)
MELANIN = (0.002, 0.45)
# Nail varnish, linear reflectance: reds, pinks, plum, nude, dark blue, black.
_VARNISH: tuple[Vec3, ...] = (
    (0.42, 0.012, 0.02), (0.20, 0.01, 0.025), (0.62, 0.16, 0.22), (0.66, 0.36, 0.33),
    (0.10, 0.012, 0.06), (0.55, 0.36, 0.28), (0.02, 0.03, 0.12), (0.012, 0.012, 0.014),
)  # fmt: skip
_EUMELANIN = ((-50.0, 0.95), (20.0, 0.85), (60.0, 0.55))


def sample_skin(tones: tuple[float, float], *, rng: np.random.Generator) -> tuple[Skin, float]:
    """Draw one person's skin.

    Parameters
    ----------
    tones : (lo, hi)
        Range of the tone, 0 lightest .. 1 darkest; the tone, and so ITA, is uniform in it.
    rng : numpy.random.Generator

    Returns
    -------
    skin : Skin
    tone : float
    """
    tone = float(rng.uniform(*tones))
    angle = ITA_DEG[0] + tone * (ITA_DEG[1] - ITA_DEG[0])
    blood = float(0.019 * np.exp(rng.normal(0.0, 0.2)))
    carotene = float(rng.uniform(0.7, 1.8))
    share, eumelanin = zip(*_EUMELANIN, strict=True)
    eu = float(np.clip(np.interp(angle, share, eumelanin) + rng.normal(0.0, 0.02), 0.4, 1.0))
    melanin = melanin_for(angle, blood, eu, carotene)
    freckled = max(angle - 25.0, 0.0) / 35.0
    dorsal, palm, nail = colours_of(melanin, blood, eu, carotene)
    skin = Skin(
        dorsal_rgb=dorsal,
        palm_rgb=palm,
        nail_rgb=nail,
        roughness=round(float(rng.uniform(0.48, 0.62)), 6),
        mottle=round(float(rng.uniform(0.03, 0.07)), 6),
        seed=int(rng.integers(2**31)),
        melanin=round(melanin, 6),
        blood=round(blood, 6),
        eumelanin=round(eu, 6),
        carotene=round(carotene, 6),
        freckles=round(float(0.35 * rng.random() ** 2 * freckled + 0.02 * rng.random()), 6),
        veins=round(float(rng.uniform(0.2, 1.0)), 6),
        creases=round(float(rng.uniform(0.7, 1.25)), 6),
        sweat=round(float(rng.random() ** 3), 6),
    )
    return skin, tone


def switched(skin: Skin, settings: SkinSettings, *, rng: np.random.Generator) -> Skin:
    """Apply a configuration's switches to a drawn skin; what was drawn stays drawn.

    Parameters
    ----------
    skin : Skin
    settings : SkinSettings
    rng : numpy.random.Generator
        Of the varnish alone.
    """
    share, colour = rng.random(), _VARNISH[rng.integers(len(_VARNISH))]
    return replace(
        skin,
        creases=round(skin.creases * settings.creases, 6),
        veins=round(skin.veins * settings.veins, 6),
        mottle=round(skin.mottle * settings.mottle, 6),
        freckles=round(min(skin.freckles * settings.freckles, 1.0), 6),
        sweat=round(min(skin.sweat * settings.sweat, 1.0), 6),
        relief_m=settings.relief_m,
        detail=settings.detail,
        varnish_rgb=colour if share < settings.varnish else None,
    )


def melanin_for(angle_deg: float, blood: float, eumelanin: float, carotene: float) -> float:
    """Return the melanin fraction whose skin has a typology angle (degrees), by bisection."""
    low, high = np.log(MELANIN)
    for _ in range(24):
        middle = (low + high) / 2
        lab = skin_lab(np.exp(middle), blood, eumelanin, carotene)
        low, high = (middle, high) if typology_angle(lab) > angle_deg else (low, middle)
    return float(np.exp((low + high) / 2))


def pigments_of(
    zone: str, melanin: float, blood: float, eumelanin: float, carotene: float
) -> tuple[float, float, float, float]:
    """Return the pigments of a zone of the same person's hand.

    Parameters
    ----------
    zone : {"dorsal", "palm", "nail"}
        Palms have little melanin, much blood and a yellow horny layer; nail beds show through a
        clear plate.
    melanin, blood, eumelanin, carotene : float
        Of the back of the hand.
    """
    if zone == "palm":
        return max(0.20 * melanin, min(melanin, 0.012)), 1.8 * blood, eumelanin, carotene + 2.0
    if zone == "nail":
        return max(0.7 * melanin, min(melanin, 0.008)), 1.35 * blood, eumelanin, carotene
    return melanin, blood, eumelanin, carotene


def colours_of(
    melanin: float, blood: float, eumelanin: float, carotene: float
) -> tuple[Vec3, Vec3, Vec3]:
    """Return the mean albedo of back, palm and nail beds, linear sRGB."""
    dorsal, palm, nail = (
        rounded(skin_rgb(*pigments_of(zone, melanin, blood, eumelanin, carotene)))
        for zone in ("dorsal", "palm", "nail")
    )
    return dorsal, palm, nail


def rounded(values: NDArray[np.float64], digits: int = 6) -> Vec3:
    """Return three numbers as plain floats, rounded, so that the plan's rows stay short."""
    a, b, c = (round(float(v), digits) for v in values)
    return a, b, c
