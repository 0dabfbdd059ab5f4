"""What a camera of a scanner makes of radiance: optics here, numbers by the shared model.

In this order: vignetting; blur by the lens and the pixel (a Gaussian beyond the pixel's own box,
which the sub-samples are); then :mod:`synthgen.render.readout`. What belongs to the scanner
(gains, stuck pixels) is frozen by the rig's seed; noise is keyed by the scan.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera
from synthgen.render import readout
from synthgen.render.readout import FixedPattern, draw_pattern
from synthgen.sampling.streams import stream
from synthgen.scanner.rig import Rig, Sensor

Image = NDArray[np.float32]
SENSOR_EFFECTS: dict[str, dict[str, Any]] = {
    "shot_noise": {"shot_noise": False},
    "read_noise": {"read_noise_e": 0.0},
    "pixel_gains": {"prnu": 0.0},
    "hot_pixels": {"hot_share": 0.0},
    "saturation": {"saturation": False},
    "quantisation": {"quantisation": False},
}
"""What a sensor adds, by name, and the fields that leave it out."""


def without(rig: Rig, effects: Iterable[str]) -> Rig:
    """Leave effects out of all sensors of a rig; what is left draws the same random numbers."""
    off: dict[str, Any] = {}
    for effect in effects:
        off |= SENSOR_EFFECTS[effect]
    return replace(rig, grey=replace(rig.grey, **off), colour=replace(rig.colour, **off))


@lru_cache(maxsize=16)
def fixed_pattern(
    seed: int, camera: int, height: int, width: int, prnu: float, hot_share: float
) -> FixedPattern:
    """Draw a sensor's fixed pattern; ``camera`` numbers the rig's cameras."""
    rng = stream(seed, "scanner", camera, 0, "fixed pattern")
    return draw_pattern(height, width, prnu, hot_share, rng=rng)


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
    (H, W) uint8 or uint16, or float32 without quantisation
    """
    held = readout.electrons(picture, sensor.readout, gain, fixed, rng=rng)
    return readout.counts(held, sensor.readout)


def automatic_gain(pictures: list[Image], background: float, target: float) -> float | None:
    """Return the gain at which the 99 % quantile of the subject reaches ``target`` full wells.

    None where nothing is brighter than the background.
    """
    bright = np.concatenate([p[p > 1.5 * background] for p in pictures])
    if not len(bright):
        return None
    return target / max(float(np.quantile(bright, 0.99)), 1e-30)
