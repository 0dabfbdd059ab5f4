"""From linear radiance to the stored 8 bits: exposure, optics, noise, balance, mosaic, curve."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.render.readout import Readout, electrons
from synthgen.sampling.streams import stream
from synthgen.scene import Sensor

Array = NDArray[np.float64]
Image = NDArray[np.float32]

MIDDLE_GREY = 0.2
# Where the curve starts to bend, so that a lit palm beside shade keeps its colour.
_KNEE = 0.6
# Luminance that the brightest fiftieth of the picture is exposed to at most.
_BRIGHTEST = 1.15
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# Adaptation is not complete in cameras either.
_BALANCED = 0.75
_DARKEST_ALBEDO = 0.04
_BLOOM_SHARE = 0.012


def exposure_of(linear: NDArray[Any]) -> float:
    """Return the automatic exposure: the picture's middle becomes middle grey.

    Half geometric, half arithmetic mean, weighted towards the centre; limited so that the 98th
    percentile of luminance is not lifted beyond 1.15.
    """
    luminance = np.asarray(linear, np.float64) @ LUMINANCE
    height, width = luminance.shape
    y, x = np.mgrid[:height, :width]
    r2 = ((x + 0.5) / width - 0.5) ** 2 + ((y + 0.5) / height - 0.5) ** 2
    weight = np.exp(-r2 / 0.18)
    weight /= weight.sum()
    floor = max(1e-4 * float(luminance.mean()), 1e-9)
    geometric = float(np.exp((np.log(np.maximum(luminance, floor)) * weight).sum()))
    mean = 0.5 * geometric + 0.5 * float((luminance * weight).sum())
    bright = float(np.quantile(luminance, 0.98))
    return min(MIDDLE_GREY / max(mean, 1e-9), _BRIGHTEST / max(bright, 1e-9))


def balance_of(linear: Image, albedo: Image | None, sensor: Sensor) -> Array:
    """Return the white balance's factors (3,): the light's colour taken out, and its error.

    The light is the median of picture over albedo, as if a grey card were everywhere: a picture's
    own average would turn hands blue before an orange wall.
    """
    factors = np.array(sensor.balance_error)
    if not sensor.white_balance or albedo is None:
        return factors
    lit = (albedo.min(axis=-1) > _DARKEST_ALBEDO) & (linear.min(axis=-1) > 0)
    if lit.sum() < 100:
        return factors
    light = np.median(linear[lit] / albedo[lit], axis=0)
    wanted = (float(light @ LUMINANCE) / np.maximum(light, 1e-9)) ** _BALANCED
    return np.asarray(factors * np.clip(wanted, 0.4, 2.5))


def develop(
    linear: NDArray[Any], sensor: Sensor, albedo: Image | None = None, view: int = 0
) -> tuple[NDArray[np.uint8], float]:
    """Expose and encode.

    Parameters
    ----------
    linear : (H, W, 3) float
        Linear sRGB radiance.
    sensor : Sensor
    albedo : (H, W, 3) float or None
        Needed for white balance.
    view : int
        Number of the view; each has noise of its own.

    Returns
    -------
    image : (H, W, 3) uint8
        sRGB.
    exposure : float
        Factor that was applied to ``linear``.
    """
    exposure = exposure_of(linear) * 2.0**sensor.exposure_ev
    x = np.maximum(np.asarray(linear, dtype=np.float64), 0) * exposure
    balance = balance_of(np.asarray(linear, np.float32), albedo, sensor)
    x = x * balance
    if sensor.psf_px > 0:
        x = _blurred(x, sensor.psf_px)
    if sensor.bloom > 0:
        glow = _blurred(np.clip(x - 0.9, 0, 4), _BLOOM_SHARE * x.shape[1])
        x = x + sensor.bloom * glow
    if sensor.full_well > 0:  # balance amplifies what was read, its noise with it
        rng = stream(sensor.seed, "sample", view, 0, "sensor noise")
        x = read_out(x / balance, sensor, rng=rng) * balance
    if sensor.bayer:
        x = demosaic(mosaic(x))
    over = _KNEE + (1 - _KNEE) * (1 - np.exp(-(np.maximum(x, _KNEE) - _KNEE) / (1 - _KNEE)))
    curve = srgb_curve(np.where(x > _KNEE, over, x))
    if sensor.sharpen > 0:
        curve = curve + sensor.sharpen * (curve - _blurred(curve, 1.0))
    return np.asarray(np.rint(255 * np.clip(curve, 0, 1)), dtype=np.uint8), exposure


def _blurred(image: Array, sigma: float) -> Array:
    return np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma), np.float64)


def read_out(x: NDArray[Any], sensor: Sensor, *, rng: np.random.Generator) -> NDArray[Any]:
    """Return exposed light (H, W, 3), 1 is white, with the sensor's shot and read noise.

    Highlights beyond white are left to the curve.
    """
    model = Readout(sensor.full_well, read_noise_e=sensor.read_e, saturation=np.inf)
    held = electrons(x, model, rng=rng)
    return np.asarray(np.maximum(held / x.dtype.type(sensor.full_well), 0))


def mosaic(x: Array) -> Array:
    """Keep one channel per pixel (H, W, 3) -> (H, W), RGGB."""
    raw = x[..., 1].copy()
    raw[::2, ::2], raw[1::2, 1::2] = x[::2, ::2, 0], x[1::2, 1::2, 2]
    return raw


def demosaic(raw: Array) -> Array:
    """Fill the channels of an RGGB mosaic (H, W) -> (H, W, 3), edge-aware, 16 bits."""
    steps = np.rint(np.clip(raw, 0, 1.5) / 1.5 * 65535).astype(np.uint16)
    padded = cv2.copyMakeBorder(steps, 4, 4, 4, 4, cv2.BORDER_REFLECT_101)
    # OpenCV names a mosaic by its second row and column, so RGGB is its BayerBG.
    full = cv2.cvtColor(padded, cv2.COLOR_BayerBG2RGB_EA)[4:-4, 4:-4]
    return np.asarray(full, np.float64) / 65535 * 1.5


def srgb_curve(linear: NDArray[Any]) -> Array:
    """Apply the IEC 61966-2-1 curve to linear values, clipped to 0..1."""
    x = np.clip(np.asarray(linear, dtype=np.float64), 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def encode_srgb(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Apply the sRGB curve and round to 8 bits."""
    return np.asarray(np.rint(255 * srgb_curve(linear)), dtype=np.uint8)
