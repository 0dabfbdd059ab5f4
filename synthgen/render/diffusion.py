"""Light that spreads under the skin, in the picture: red farther than green, green than blue.

Irradiance (picture over albedo) is blurred within the skin's mask by two Gaussians per channel
with the widths of a diffusion profile in millimetres; melanin above it narrows nothing but hides
what comes out, which the albedo already says. Highlights stay where they are: they are the
surface's own, as is a share of the light that shows its relief.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera
from synthgen.models.joints import PART_FOREARM
from synthgen.render.labels import Labels

Image = NDArray[np.float32]

# Mean free path of red, green, blue light in skin, metres; and the two Gaussians' share and width.
REACH_M = (2.2e-3, 0.9e-3, 0.5e-3)
_GAUSSIANS = ((0.55, 0.35), (0.45, 1.0))
_DARKEST = 0.02
# What the surface itself reflects, and the relief in it, never enters the skin.
_SURFACE = 0.25
# Irradiance beyond this multiple of that around it is a highlight.
_HIGHLIGHT, _AROUND_M = 1.4, 4e-3

# The picture cannot tell a finger from the one behind it: no pixel changes by more than this.
_MOST = 1.3


def diffuse(linear: Image, albedo: Image, labels: Labels, camera: Camera) -> Image:
    """Return the picture (H, W, 3) with light spread under the skin; other pixels unchanged."""
    skin = (labels.part_id > 0) & (labels.part_id <= PART_FOREARM)
    if skin.sum() < 16:
        return linear
    pixels_per_metre = camera.fx / float(np.median(labels.depth_z_m[skin]))
    mask = skin.astype(np.float32)
    out = linear.copy()
    for channel, reach in enumerate(REACH_M):
        tint = np.maximum(albedo[..., channel], _DARKEST)
        irradiance = np.asarray(linear[..., channel] / tint * mask, dtype=np.float32)
        around = _blurred(irradiance, mask, _AROUND_M * pixels_per_metre)
        inside = np.float32(1 - _SURFACE) * np.minimum(irradiance, _HIGHLIGHT * around)
        spread = np.zeros_like(mask)
        for share, width in _GAUSSIANS:
            spread += share * _blurred(inside, mask, width * reach * pixels_per_metre)
        lit = spread + irradiance - inside
        lit = np.clip(lit, irradiance / _MOST, irradiance * _MOST)
        out[..., channel] = np.where(skin, tint * lit, linear[..., channel])
    return out


def _blurred(values: Image, mask: Image, sigma: float) -> Image:
    """Blur masked values within their mask; less than a quarter pixel is nothing to see."""
    if sigma < 0.25:
        return values
    weight = np.maximum(cv2.GaussianBlur(mask, (0, 0), sigma), 1e-3)
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma) / weight, dtype=np.float32)
