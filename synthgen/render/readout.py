"""From light on a pixel to the number that is read: one model for every simulated camera.

In this order: exposure into electrons; the pixels' own gains (PRNU); shot noise (Gaussian of
variance ``e``, which equals Poisson above some ten electrons, below which read noise rules); read
noise; saturation; stuck bright pixels; black level and quantisation. Light is in shares of the
full well: 1 fills it at gain 1. The grey and colour cameras of scanners use all of it; the cameras
of views (:mod:`synthgen.render.sensor`) develop what they read into a picture, so they leave the
fixed pattern, which cameras correct, and the quantisation, which the picture's own 8 bits exceed,
switched off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Readout:
    """How a sensor turns light into numbers; every effect has a value that switches it off.

    Attributes
    ----------
    full_well_e : float
        Electrons at light 1; the signal in electrons, and with it shot noise, follows from it.
    shot_noise : bool
    read_noise_e : float
        Sigma, electrons; 0 is off.
    prnu : float
        Relative sigma of the pixels' gains; 0 is off.
    hot_share : float
        Share of pixels that are stuck bright; 0 is off.
    saturation : float
        Shares of the full well beyond which nothing is added; ``inf`` is off.
    bits : int
        Of the counts that :func:`counts` makes.
    quantisation : bool
        False leaves fractions of counts.
    black_dn : float
        Offset added before quantisation, counts of an 8-bit sensor.
    """

    full_well_e: float
    shot_noise: bool = True
    read_noise_e: float = 0.0
    prnu: float = 0.0
    hot_share: float = 0.0
    saturation: float = 1.0
    bits: int = 8
    black_dn: float = 0.0
    quantisation: bool = True

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return int(2**self.bits - 1)


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


def draw_pattern(
    height: int, width: int, prnu: float, hot_share: float, *, rng: np.random.Generator
) -> FixedPattern:
    """Draw the fixed pattern of a sensor."""
    gain = rng.standard_normal((height, width), dtype=np.float32)
    gain *= np.float32(prnu)
    gain += 1
    count = rng.binomial(height * width, hot_share)
    hot = rng.choice(height * width, count, replace=False)
    level = rng.uniform(0.2, 1.5, count).astype(np.float32)
    return FixedPattern(gain, np.asarray(hot, dtype=np.int64), level)


def electrons(
    light: NDArray[Any], readout: Readout, gain: float = 1.0, fixed: FixedPattern | None = None,
    *, rng: np.random.Generator,
) -> NDArray[Any]:  # fmt: skip
    """Expose: what the pixels hold.

    Parameters
    ----------
    light : (H, W) or (H, W, C) float32 or float64
        On the sensor, in shares of the full well at gain 1; below 0 counts as 0.
    readout : Readout
    gain : float
        Full wells per unit of light.
    fixed : FixedPattern or None
        Of this sensor, for (H, W) light; None has none.

    Returns
    -------
    (H, W) or (H, W, C), the precision of ``light``
        Electrons; read noise makes some of them negative.
    """
    kind = light.dtype.type
    held = np.maximum(light, 0, order="C") * kind(gain * readout.full_well_e)
    if readout.prnu and fixed is not None:
        held *= fixed.gain
    variance = kind(readout.read_noise_e**2)
    if readout.shot_noise or variance:
        noise = rng.standard_normal(held.shape, dtype=kind)
        noise *= np.sqrt(held + variance if readout.shot_noise else variance)
        held += noise
    well = kind(readout.full_well_e)
    most = kind(readout.saturation) * well
    np.minimum(held, most, out=held)
    if readout.hot_share and fixed is not None:
        flat = held.reshape(-1)
        flat[fixed.hot] = np.minimum(np.maximum(flat[fixed.hot], fixed.hot_level * well), most)
    return np.asarray(held)


def counts(held: NDArray[Any], readout: Readout) -> NDArray[Any]:
    """Digitise electrons: counts (H, W).

    uint8, or uint16 for more than 8 bits and where nothing saturates; float32 without quantisation.
    """
    full = readout.full_scale
    digital = held * (held.dtype.type(full) / held.dtype.type(readout.full_well_e))
    digital += held.dtype.type(readout.black_dn * full / 255)
    wide = not np.isfinite(readout.saturation)
    if not readout.quantisation:
        return np.asarray(np.clip(digital, 0, np.inf if wide else full).astype(np.float32))
    rounded = np.clip(np.rint(digital), 0, np.iinfo(np.uint16).max if wide else full)
    return np.asarray(rounded.astype(np.uint8 if readout.bits <= 8 and not wide else np.uint16))
