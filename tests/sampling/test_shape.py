"""Shape sampling: a truncated normal, exactly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from synthgen.errors import SamplingError
from synthgen.sampling.shape import sample_shape
from synthgen.sampling.streams import stream


def test_shape() -> None:
    assert sample_shape(10, sigma=1.0, limit=3.0, rng=stream(0, "subject", 0, 0, "s")).shape == (
        10,
    )


@pytest.mark.parametrize(("sigma", "limit"), [(1.0, 3.0), (0.5, 0.5)])
def test_reference_scipy_truncnorm(sigma: float, limit: float) -> None:
    draws = sample_shape(20_000, sigma=sigma, limit=limit, rng=stream(1, "subject", 0, 0, "s"))
    exact = stats.truncnorm(-limit / sigma, limit / sigma, scale=sigma)
    assert stats.kstest(draws, exact.cdf).pvalue > 0.01
    assert np.abs(draws).max() <= limit


@pytest.mark.parametrize(("sigma", "limit"), [(0.0, 3.0), (1.0, -1.0)])
def test_edge_bad_settings(sigma: float, limit: float) -> None:
    with pytest.raises(SamplingError, match="must be > 0"):
        sample_shape(3, sigma=sigma, limit=limit, rng=stream(0, "subject", 0, 0, "s"))
