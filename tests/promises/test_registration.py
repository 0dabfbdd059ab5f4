"""What registration promises, on 300 scans of poses that training never saw (minutes)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from synthgen.cli import bench

N = 300


@pytest.fixture(scope="module")
def benchmark() -> Any:
    return bench._load(bench.FOLDER / "registration.py")


@pytest.mark.prove
def test_properties_cold_starts(benchmark: Any) -> None:
    found = benchmark.series(N, 20, "cold")
    error = np.array([o.error for o in found])
    wide = np.array([o.case.seen.mean() >= 0.5 for o in found])
    assert (error < 5).mean() >= 0.99
    assert (error < 1.5).mean() >= 0.92
    assert (error[wide] < 1.5).mean() >= 0.96
    assert not any(o.false_pass for o in found)
    cpu_s = [o.cpu_s for o in found[1:]]
    assert np.median(cpu_s) <= 1.5
    assert np.quantile(cpu_s, 0.95) <= 4


@pytest.mark.prove
def test_properties_known_rotations(benchmark: Any) -> None:
    found = benchmark.series(N, 21, "perturbed")
    error = np.array([o.error for o in found])
    assert (error < 1.5).mean() >= 0.97
    assert error[error < 1.5].mean() <= 0.08
    assert not any(o.false_pass for o in found)
    assert np.median([o.cpu_s for o in found[1:]]) <= 0.9


@pytest.mark.prove
@pytest.mark.parametrize(("noise_m", "seed", "mean_mm"), [(5e-4, 90, 0.18), (1e-3, 140, 0.36)])
def test_properties_noise(benchmark: Any, noise_m: float, seed: int, mean_mm: float) -> None:
    found = benchmark.series(N // 3, seed, "perturbed", noise_m=noise_m)
    error = np.array([o.error for o in found])
    assert (error < 1.5).mean() >= 0.9
    assert error[error < 1.5].mean() <= mean_mm
