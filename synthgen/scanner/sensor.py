"""From radiance to counts: what a camera of a scanner adds, effect by effect.

In this order: vignetting; blur by the lens and the pixel (a Gaussian beyond the pixel's own box,
which the sub-samples are); exposure into electrons; the pixels' own gains; shot noise (Gaussian of
variance ``e``, which equals Poisson above some ten electrons, below which read noise rules); read
noise; saturation at the full well; stuck bright pixels; black level and quantisation. What belongs
to the scanner (gains, stuck pixels) is frozen by the rig's seed; noise is keyed by the scan.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera
from synthgen.sampling.streams import stream
from synthgen.scanner.rig import Sensor

Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """What is peculiar to one sensor.

    Attributes
    ----------
    gain : (H, W) float32
        Relative, mean 1.
    hot : (n,) int64
        Stuck pixels, row-major, and ``hot_level`` (n,) float32, shares of the full well.
    """

    gain: Image
    hot: NDArray[np.int64]
    hot_level: Image


@lru_cache(maxsize=16)
def fixed_pattern(
    seed: int, camera: int, height: int, width: int, prnu: float, hot_share: float
) -> FixedPattern:
    """Draw a sensor's fixed pattern; ``camera`` numbers the rig's cameras."""
    rng = stream(seed, "scanner", camera, 0, "fixed pattern")
    gain = rng.standard_normal((height, width), dtype=np.float32)
    gain *= np.float32(prnu)
    gain += 1
    count = rng.binomial(height * width, hot_share)
    hot = rng.choice(height * width, count, replace=False)
    level = rng.uniform(0.2, 1.5, count).astype(np.float32)
    return FixedPattern(gain, np.asarray(hot, dtype=np.int64), level)


def optical(radiance: Image, sensor: Sensor, camera: Camera) -> Image:
    """Apply vignetting and blur: the picture (H, W) on the sensor, radiance still."""
    picture = radiance
    if sensor.vignetting:
        picture = picture * _falloff(camera) ** np.float32(sensor.vignetting)
    if not sensor.psf_px:
        return picture
    blurred = cv2.GaussianBlur(picture, (0, 0), sensor.psf_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, dtype=np.float32)


def _falloff(camera: Camera) -> Image:
    """Cosine of the angle off the axis, distortion left aside."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return np.asarray(1 / np.sqrt(1 + x * x + (y * y)[:, None]), dtype=np.float32)


def counts(
    picture: Image, sensor: Sensor, gain: float, fixed: FixedPattern, *, rng: np.random.Generator
) -> NDArray[Any]:
    """Expose and digitise.

    Parameters
    ----------
    picture : (H, W) float32
        Radiance on the sensor, of :func:`optical`.
    sensor : Sensor
    gain : float
        Full wells per unit of radiance.
    fixed : FixedPattern

    Returns
    -------
    (H, W) uint8 or uint16
    """
    well = np.float32(sensor.full_well_e)
    electrons = np.maximum(picture, 0) * np.float32(gain * sensor.full_well_e)
    if sensor.prnu:
        electrons *= fixed.gain
    variance = np.float32(sensor.read_noise_e**2)
    if sensor.shot_noise or variance:
        noise = rng.standard_normal(electrons.shape, dtype=np.float32)
        noise *= np.sqrt(electrons + variance if sensor.shot_noise else variance)
        electrons += noise
    np.minimum(electrons, well, out=electrons)
    if sensor.hot_share:
        flat = electrons.reshape(-1)
        flat[fixed.hot] = np.minimum(np.maximum(flat[fixed.hot], fixed.hot_level * well), well)
    full = sensor.full_scale
    electrons *= np.float32(full) / well
    electrons += np.float32(sensor.black_dn * full / 255)
    digital = np.clip(np.rint(electrons), 0, full)
    return np.asarray(digital.astype(np.uint8 if sensor.bits == 8 else np.uint16))


def automatic_gain(pictures: list[Image], background: float, target: float) -> float | None:
    """Return the gain at which the 99 % quantile of the subject reaches ``target`` full wells.

    None where nothing is brighter than the background.
    """
    bright = np.concatenate([p[p > 1.5 * background] for p in pictures])
    if not len(bright):
        return None
    return target / max(float(np.quantile(bright, 0.99)), 1e-30)
