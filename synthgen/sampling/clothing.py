"""What a subject wears: sleeve, rings, bracelet, watch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.config.places import WearSettings
from synthgen.sampling.appearance import linear_rgb_from_lab, rounded
from synthgen.scene import Band, Sleeve
from synthgen.scene.description import Vec3

Array = NDArray[np.float64]

# Reflectance of metals at normal incidence, linear sRGB.
_METALS = np.array([[1.0, 0.77, 0.34], [0.95, 0.93, 0.88], [0.91, 0.78, 0.68], [0.55, 0.54, 0.52]])
_RING_FINGERS = (10, 10, 4, 1, 7)  # ring finger twice, middle, index, pinky: model joints


def sample_wear(
    settings: WearSettings, *, rng: np.random.Generator
) -> tuple[Sleeve | None, tuple[Band, ...]]:
    """Draw what is worn; every piece takes its draws whether it is worn or not."""
    worn = rng.random(4)
    sleeve, ring = _sleeve(rng), _ring(rng)
    bracelet, watch = _bracelet(rng), _watch(rng)
    long = sleeve.start_m < 0.06
    bands = [(ring, worn[1] < settings.ring)]
    # One thing at a wrist, and none under a long sleeve's cuff.
    at_wrist = worn[2] < settings.bracelet and not (long and worn[0] < settings.sleeve)
    bands.append((bracelet, at_wrist))
    free = not at_wrist and not (long and worn[0] < settings.sleeve)
    bands.append((watch, worn[3] < settings.watch and free))
    return (
        sleeve if worn[0] < settings.sleeve else None,
        tuple(band for band, on in bands if on),
    )


def _sleeve(rng: np.random.Generator) -> Sleeve:
    start = rng.uniform(0.012, 0.05) if rng.random() < 0.65 else rng.uniform(0.06, 0.2)
    return Sleeve(
        start_m=round(float(start), 6),
        slack_m=round(float(rng.uniform(0.004, 0.009)), 6),
        fold_m=round(float(rng.uniform(0.001, 0.0028)), 6),
        colour_rgb=_cloth(rng),
        accent_rgb=_cloth(rng),
        pattern=("plain", "plain", "stripes", "checks")[int(rng.integers(4))],
        seed=int(rng.integers(2**31)),
    )


def _cloth(rng: np.random.Generator) -> Vec3:
    strong = rng.random() < 0.4
    chroma, hue = rng.uniform(15, 45) if strong else rng.uniform(0, 10), rng.uniform(0, 2 * np.pi)
    lab = np.array([rng.uniform(12, 88), chroma * np.cos(hue), chroma * np.sin(hue)])
    return rounded(linear_rgb_from_lab(lab))


def _metal(rng: np.random.Generator) -> Vec3:
    return rounded(_METALS[int(rng.integers(len(_METALS)))])


def _ring(rng: np.random.Generator) -> Band:
    return Band(
        kind="ring",
        finger=int(rng.choice(_RING_FINGERS)),
        place=round(float(rng.uniform(0.56, 0.68)), 6),
        width_m=round(float(rng.uniform(0.002, 0.006)), 6),
        thickness_m=round(float(rng.uniform(0.0012, 0.002)), 6),
        colour_rgb=_metal(rng),
        metal=True,
    )


def _bracelet(rng: np.random.Generator) -> Band:
    metal = bool(rng.random() < 0.5)
    colour = _metal(rng) if metal else _cloth(rng)
    return Band(
        kind="bracelet",
        finger=0,
        place=round(float(rng.uniform(0.018, 0.045)), 6),
        width_m=round(float(rng.uniform(0.003, 0.014)), 6),
        thickness_m=round(float(rng.uniform(0.002, 0.004)), 6),
        colour_rgb=colour,
        metal=metal,
    )


def _watch(rng: np.random.Generator) -> Band:
    metal = bool(rng.random() < 0.4)
    dark = rounded(np.array([0.03, 0.03, 0.03]) + 0.05 * rng.random(3))
    return Band(
        kind="watch",
        finger=0,
        place=round(float(rng.uniform(0.025, 0.04)), 6),
        width_m=round(float(rng.uniform(0.016, 0.022)), 6),
        thickness_m=round(float(rng.uniform(0.002, 0.003)), 6),
        colour_rgb=_metal(rng) if metal else dark,
        metal=metal,
    )
