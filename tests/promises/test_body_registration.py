"""What registration of bodies promises (minutes)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from synthgen.cli import bench

N = 20


@pytest.fixture(scope="module")
def benchmark() -> Any:
    return bench._load(bench.FOLDER / "body_registration.py")


@pytest.mark.prove
def test_properties_cold_starts(benchmark: Any) -> None:
    found = benchmark.cold_series(N, 10)
    assert np.mean([c.body < 5 for c in found]) >= 0.95
    good = [c for c in found if c.body < 5]
    assert np.mean([c.body for c in good]) <= 0.6
    assert np.mean([c.hands for c in good]) <= 2.5
    assert np.median([c.cpu_s for c in found[1:]]) <= 3


@pytest.mark.prove
def test_properties_cold_starts_of_free_poses(benchmark: Any) -> None:
    """Arms may be where coarse steps do not look for them."""
    found = benchmark.cold_series(N, 11, spread=1.0)
    passed = [c for c in found if c.verdict == "pass"]
    assert len(passed) >= 0.9 * N
    assert max(c.body for c in passed) <= 2
    assert max(c.hands for c in passed) <= 8
    assert np.median([c.cpu_s for c in found[1:]]) <= 3


@pytest.mark.prove
def test_properties_tracking_and_gaps(benchmark: Any) -> None:
    found = benchmark.gap_series(N, 10)
    assert np.mean([f.body for f in found]) <= 0.4
    assert np.mean([f.hands for f in found]) <= 2.5
    assert np.mean([f.cpu_s for f in found[1:]]) <= 0.3
    assert np.mean([f.jitter for f in found]) <= 3
    assert all(f.reported for f in found)
    assert np.mean([f.back <= 4 for f in found]) >= 0.8
