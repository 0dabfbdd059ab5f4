"""Seed, checks, refinement on a grid, curvature."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from speckle import Plane, Sphere

from synthgen.errors import ScanError, ShapeError
from synthgen.scanner.match import BEST, FAST, DisparityGrid, bend_bias, lit, match

BOUNDS = (-45.0, 50.0)


def errors(grid: DisparityGrid, true: Any) -> Any:
    d = true[:: grid.step, :: grid.step]
    return np.where(grid.matched, grid.disparity - d, np.nan)


@pytest.mark.parametrize("settings", [FAST, replace(FAST, seed_scale=1), BEST])
def test_reference_plane(seen: Any, settings: Any) -> None:
    _, left, right, true = seen(Plane(0))
    grid = match(left, right, BOUNDS, settings)
    error = errors(grid, true)
    assert np.isfinite(error).mean() > 0.8
    assert np.nanstd(error) < 0.02
    assert abs(np.nanmean(error)) < 0.003


def test_properties_curvature_bias_is_removed(seen: Any) -> None:
    """Of the 9 mm sphere, a finger: ten times less bias where it faces the pair."""
    pair, left, right, true = seen(Sphere(0.009))
    y, x = np.mgrid[0 : true.shape[0] : 3, 0 : true.shape[1] : 3]
    facing = np.linalg.norm(pair.points(x, y, true[::3, ::3])[..., :2], axis=-1) < 0.005
    biased = match(left, right, BOUNDS, replace(FAST, correct_curvature=False))
    means = [
        np.nanmean(errors(g, true)[facing]) for g in (biased, match(left, right, BOUNDS, FAST))
    ]
    assert means[0] < -0.04
    assert abs(means[1]) < abs(means[0]) / 5


def test_reference_bend_bias_of_a_paraboloid() -> None:
    y, x = np.mgrid[0:90:3, 0:90:3].astype(float)
    slope = np.stack([0.002 * x, 0.004 * y], axis=-1)
    bias = bend_bias(slope, 3, 10.0)
    assert bias[8:-8, 8:-8] == pytest.approx(10 / 2 * 0.006, rel=1e-4)


def test_properties_background_is_left_out(seen: Any) -> None:
    _, left, right, true = seen(Sphere(0.009))
    grid = match(left, right, BOUNDS, FAST)
    beside = ~np.isfinite(true[::3, ::3])
    assert (grid.matched & beside).sum() < 0.15 * grid.matched.sum()
    assert not lit(np.zeros((50, 50)), FAST).any()


def test_edge_bad_input() -> None:
    black = np.full((60, 60), 3.0)
    with pytest.raises(ScanError, match="light nothing"):
        match(black, black, BOUNDS, FAST)
    with pytest.raises(ShapeError, match="lower one"):
        match(black, black, (5.0, 5.0), FAST)
    with pytest.raises(ShapeError, match="shapes"):
        match(black, black[1:], BOUNDS, FAST)
