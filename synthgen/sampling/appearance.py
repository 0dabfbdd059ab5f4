"""Appearance of skin, light and background; colours are linear sRGB.

Skin runs along a curve in CIELAB (D65): lightness falls while yellow first rises and then falls,
as measured skin does; palms and nail beds keep little melanin, so dark skin has light palms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.scene import Skin
from synthgen.scene.description import Vec3

# tone 0 (lightest) .. 1 (darkest): columns L*, a*, b*
_TONE = np.array([0.0, 0.17, 0.33, 0.5, 0.67, 0.85, 1.0])
_DORSAL_LAB = np.array(
    [[72, 11, 13], [67, 12, 15], [61, 13, 18], [53, 14, 20.5], [44, 14.5, 20], [33, 11.5, 15],
     [26, 8.5, 11]], dtype=np.float64,
)  # fmt: skip
_PALM_LAB = np.array(
    [[71, 14, 14], [69, 14, 15], [66, 14, 16], [63, 14, 17], [60, 14, 18], [57, 14, 17],
     [54, 13, 17]], dtype=np.float64,
)  # fmt: skip
_XYZ_WHITE = np.array([0.95047, 1.0, 1.08883])
_RGB_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314],
     [-0.9692660, 1.8760108, 0.0415560],
     [0.0556434, -0.2040259, 1.0572252]]
)  # fmt: skip


def linear_rgb_from_lab(lab: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert CIELAB (D65, 2 degree observer) to linear sRGB, clipped to [0, 1].

    Parameters
    ----------
    lab : (..., 3) float64
        L* in 0..100, a*, b*.

    Returns
    -------
    (..., 3) float64
        IEC 61966-2-1 primaries, no transfer curve.
    """
    fy = (lab[..., 0] + 16) / 116
    f = np.stack([fy + lab[..., 1] / 500, fy, fy - lab[..., 2] / 200], axis=-1)
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * _XYZ_WHITE
    return np.asarray(np.clip(xyz @ _RGB_FROM_XYZ.T, 0.0, 1.0), dtype=np.float64)


def sample_skin(tones: tuple[float, float], *, rng: np.random.Generator) -> tuple[Skin, float]:
    """Draw one person's skin.

    Parameters
    ----------
    tones : (lo, hi)
        Range of the tone, 0 lightest .. 1 darkest; the tone is uniform in it.
    rng : numpy.random.Generator

    Returns
    -------
    skin : Skin
    tone : float
    """
    tone = float(rng.uniform(*tones))
    spread = rng.normal(0.0, [1.2, 0.8, 0.9])
    dorsal = _on_curve(tone, _DORSAL_LAB) + spread
    palm = _on_curve(tone, _PALM_LAB) + 0.6 * spread
    nail = palm + np.array([4.0, 3.0, -3.0])
    skin = Skin(
        dorsal_rgb=rounded(linear_rgb_from_lab(dorsal)),
        palm_rgb=rounded(linear_rgb_from_lab(palm)),
        nail_rgb=rounded(linear_rgb_from_lab(nail)),
        roughness=round(float(rng.uniform(0.42, 0.58)), 6),
        mottle=round(float(rng.uniform(0.03, 0.08)), 6),
        seed=int(rng.integers(2**31)),
    )
    return skin, tone


def rounded(values: NDArray[np.float64], digits: int = 6) -> Vec3:
    """Return three numbers as plain floats, rounded, so that the plan's rows stay short."""
    a, b, c = (round(float(v), digits) for v in values)
    return a, b, c


def _on_curve(tone: float, table: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([np.interp(tone, _TONE, column) for column in table.T])
