"""The Dr.Jit matcher against its NumPy reference, and against the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from speckle import Plane, Sphere

from synthgen.sampling.streams import stream
from synthgen.scanner.dic import refine
from synthgen.scanner.dic_reference import DicSettings, refine_reference

QUADRATIC = DicSettings(window=19, order=2)


def grid(true: Any, step: int = 5) -> Any:
    y, x = np.mgrid[20:220:step, 20:300:step]
    d = true[y, x]
    known = np.isfinite(d)
    rng = stream(0, "sample", 0, 0, "seeds")
    xy = np.stack([x[known], y[known]], axis=1)
    return xy, d[known], d[known] + rng.uniform(-0.5, 0.5, known.sum())


@pytest.mark.parametrize("settings", [DicSettings(), QUADRATIC], ids=["affine", "quadratic"])
@pytest.mark.parametrize("surface", [Plane(30), Sphere(0.009)], ids=["plane", "sphere"])
def test_reference(seen: Any, surface: Any, settings: DicSettings) -> None:
    _, left, right, true = seen(surface)
    xy, _, seed = grid(true, 23)
    fast = refine(left, right, xy, seed, settings)
    slow = refine_reference(left, right, xy, seed, settings)
    assert (fast.valid == slow.valid).mean() > 0.98
    both = fast.valid & slow.valid
    assert both.mean() > 0.7
    for name, tolerance in (("disparity", 2e-4), ("slope", 1e-4), ("correlation", 1e-4)):
        a, b = getattr(fast, name)[both], getattr(slow, name)[both]
        assert np.median(np.abs(a - b)) < tolerance / 20, name
        assert np.quantile(np.abs(a - b), 0.98) < tolerance, name
    assert fast.sigma[both] == pytest.approx(slow.sigma[both], rel=0.02)


def test_properties_plane_is_exact(seen: Any) -> None:
    _, left, right, true = seen(Plane(30))
    xy, d, seed = grid(true)
    found = refine(left, right, xy, seed, DicSettings())
    error = (found.disparity - d)[found.valid]
    assert found.valid.mean() > 0.9
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert abs(error.mean()) < 0.002
    slope = np.gradient(true, axis=1)[xy[:, 1], xy[:, 0]][found.valid]
    assert np.abs(found.slope[found.valid, 0] - slope).mean() < 0.01


def test_properties_sigma_is_no_decoration(seen: Any) -> None:
    """Errors are of the size that the residuals promise."""
    _, left, right, true = seen(Plane(0))
    xy, d, seed = grid(true)
    found = refine(left, right, xy, seed, DicSettings())
    error = np.abs(found.disparity - d)
    assert 0.3 < np.median(error) / np.median(found.sigma) < 2.5


def test_edge_nothing_to_match() -> None:
    empty = refine(np.zeros((9, 9)), np.zeros((9, 9)), np.zeros((0, 2), int), np.zeros(0),
                   DicSettings())  # fmt: skip
    assert empty.disparity.shape == (0,)
    flat = np.full((40, 40), 90.0)
    found = refine(flat, flat, np.array([[20, 20], [2, 2]]), np.zeros(2), DicSettings())
    assert not found.valid.any()
