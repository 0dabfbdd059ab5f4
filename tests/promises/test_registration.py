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


@pytest.mark.prove
def test_properties_known_rotations(benchmark: Any) -> None:
    found = benchmark.series(N, 21, "perturbed")
    error = np.array([o.error for o in found])
    assert (error < 1.5).mean() >= 0.97
    assert error[error < 1.5].mean() <= 0.08
    assert not any(o.false_pass for o in found)
