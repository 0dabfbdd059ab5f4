"""From linear radiance to an 8-bit picture: exposure, a soft shoulder, the sRGB curve."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MIDDLE_GREY = 0.2
_KNEE = 0.8


def exposure_of(linear: NDArray[Any]) -> float:
    """Return the automatic exposure: the picture's geometric mean becomes middle grey.

    Limited so that the 98th percentile of luminance is not lifted beyond 1.6.
    """
    luminance = np.asarray(linear, np.float64) @ [0.2126, 0.7152, 0.0722]
    mean = float(np.exp(np.mean(np.log(np.maximum(luminance, 1e-4)))))
    bright = float(np.quantile(luminance, 0.98))
    return min(MIDDLE_GREY / mean, 1.6 / max(bright, 1e-6))


def develop(linear: NDArray[Any]) -> tuple[NDArray[np.uint8], float]:
    """Expose and encode.

    Parameters
    ----------
    linear : (H, W, 3) float
        Linear sRGB radiance.

    Returns
    -------
    image : (H, W, 3) uint8
        sRGB.
    exposure : float
        Factor that was applied to ``linear``.
    """
    exposure = exposure_of(linear)
    x = np.maximum(np.asarray(linear, dtype=np.float64) * exposure, 0)
    over = _KNEE + (1 - _KNEE) * (1 - np.exp(-(x - _KNEE) / (1 - _KNEE)))
    return encode_srgb(np.where(x > _KNEE, over, x)), exposure


def encode_srgb(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Apply the IEC 61966-2-1 curve to linear values and round to 8 bits."""
    x = np.clip(np.asarray(linear, dtype=np.float64), 0, 1)
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curve), dtype=np.uint8)
