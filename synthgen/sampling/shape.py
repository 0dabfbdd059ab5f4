"""Body shape: independent truncated normal betas."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from synthgen.errors import SamplingError


def sample_shape(
    n_betas: int, *, sigma: float, limit: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw betas ~ N(0, sigma^2) truncated at +-limit.

    By inversion, so that exactly ``n_betas`` numbers are taken from ``rng``.

    Parameters
    ----------
    n_betas : int
        Number of shape components.
    sigma : float
        Standard deviation before truncation, in units of the model's betas, > 0.
    limit : float
        Largest absolute value, in the same units, > 0.
    rng : numpy.random.Generator

    Returns
    -------
    (nb,) float64

    Raises
    ------
    SamplingError
        If ``sigma`` or ``limit`` is not positive.
    """
    if sigma <= 0 or limit <= 0:
        raise SamplingError(f"shape sigma={sigma}, limit={limit}: both must be > 0")
    low = ndtr(-limit / sigma)
    u = low + (1 - 2 * low) * rng.random(n_betas)
    return np.asarray(np.clip(sigma * ndtri(u), -limit, limit), dtype=np.float64)
