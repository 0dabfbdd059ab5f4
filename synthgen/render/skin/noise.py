"""Solid noise: random functions of the rest position, the same on both sides of a texture seam."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from synthgen.sampling.streams import stream

Values = NDArray[np.float32]

_CELLS = 48


def solid_noise(
    points: NDArray[Any], wavelength_m: float, name: str, octaves: int = 1, gain: float = 0.55
) -> Values:
    """Band-limited noise with zero mean and about unit standard deviation.

    Parameters
    ----------
    points : (n, 3) float
        Metres.
    wavelength_m : float
        Of the coarsest octave; each further one halves it and is weaker by ``gain``.
    name : str
        Which noise; the same name is the same function.

    Returns
    -------
    (n,) float32
    """
    where = np.ascontiguousarray(points, dtype=np.float32)
    total, strength, power = np.zeros(len(where), np.float32), 1.0, 0.0
    for octave in range(octaves):
        cell = np.float32(wavelength_m / 2**octave / 2)
        values = _trilinear(_volume(f"{name}/{octave}"), where / cell)
        total += np.float32(strength) * values
        power += strength**2
        strength *= gain
    return np.asarray(total / np.float32(np.sqrt(power)), dtype=np.float32)


@lru_cache(maxsize=64)
def _volume(name: str) -> Values:
    white = stream(0, "corpus", 0, 0, f"skin noise/{name}").standard_normal((_CELLS,) * 3)
    smooth = ndimage.gaussian_filter(white, 0.8, mode="wrap")
    # Linear interpolation between cells loses some of the variance.
    return np.asarray(smooth / smooth.std() * 1.15, dtype=np.float32)


@njit(cache=True)
def _trilinear(volume: Any, where: Any) -> Any:
    n = len(volume)
    out = np.empty(len(where), np.float32)
    for p in range(len(where)):
        x, y, z = where[p, 0], where[p, 1], where[p, 2]
        fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
        i, j, k = int(fx) % n, int(fy) % n, int(fz) % n
        u, v, w = x - fx, y - fy, z - fz
        i1, j1, k1 = (i + 1) % n, (j + 1) % n, (k + 1) % n
        near = (volume[i, j, k] * (1 - w) + volume[i, j, k1] * w) * (1 - v) + (
            volume[i, j1, k] * (1 - w) + volume[i, j1, k1] * w
        ) * v
        far = (volume[i1, j, k] * (1 - w) + volume[i1, j, k1] * w) * (1 - v) + (
            volume[i1, j1, k] * (1 - w) + volume[i1, j1, k1] * w
        ) * v
        out[p] = near * (1 - u) + far * u
    return out
