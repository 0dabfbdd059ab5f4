"""Colour spaces: CIELAB (D65, 2 degree observer), XYZ and linear sRGB."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

XYZ_WHITE = np.array([0.95047, 1.0, 1.08883])
_RGB_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314],
     [-0.9692660, 1.8760108, 0.0415560],
     [0.0556434, -0.2040259, 1.0572252]]
)  # fmt: skip


def linear_rgb_from_xyz(xyz: NDArray[Any]) -> Array:
    """Convert XYZ (..., 3), white Y = 1, to linear sRGB, clipped to [0, 1]."""
    return np.asarray(np.clip(np.asarray(xyz) @ _RGB_FROM_XYZ.T, 0.0, 1.0), dtype=np.float64)


def xyz_from_linear_rgb(rgb: NDArray[Any]) -> Array:
    """Convert linear sRGB (..., 3) to XYZ, white Y = 1."""
    return np.asarray(np.asarray(rgb) @ np.linalg.inv(_RGB_FROM_XYZ).T, dtype=np.float64)


def lab_from_xyz(xyz: NDArray[Any]) -> Array:
    """Convert XYZ (..., 3), white Y = 1, to CIELAB (CIE 15:2004)."""
    t = np.asarray(xyz, dtype=np.float64) / XYZ_WHITE
    f = np.where(t > (6 / 29) ** 3, np.cbrt(np.maximum(t, 0)), t / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def linear_rgb_from_lab(lab: NDArray[np.float64]) -> Array:
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
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * XYZ_WHITE
    return linear_rgb_from_xyz(xyz)


def typology_angle(lab: NDArray[Any]) -> Array:
    """Individual typology angle of skin colours (..., 3): atan((L* - 50) / b*), degrees.

    Chardon et al. 1991; above 55 very light, 41-55 light, 28-41 intermediate, 10-28 tan,
    -30-10 brown, below -30 dark.
    """
    lab = np.asarray(lab, dtype=np.float64)
    return np.asarray(np.degrees(np.arctan2(lab[..., 0] - 50, lab[..., 2])))
