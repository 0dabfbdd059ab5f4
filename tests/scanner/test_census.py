"""The consumer matcher."""

from __future__ import annotations

from typing import Any

import numpy as np
from speckle import Plane, Sphere

from synthgen.scanner.census import CensusSettings, census, match_census

BOUNDS = (-12.0, 12.0)


def test_reference_census_by_hand() -> None:
    image = np.zeros((7, 7))
    image[0, 0] = 1.0  # brighter than its opposite: the first of 24 bits
    assert census(image)[3, 3] == 1 << 23
    assert not census(np.full((9, 9), 5.0)).any()


def test_properties_plane(seen: Any) -> None:
    _, left, right, true = seen(Plane(0))
    grid = match_census(left[60:160], right[60:160], BOUNDS)
    error = (grid.disparity - true[60:160])[grid.matched]
    assert grid.step == 1
    assert grid.matched.mean() > 0.6
    assert 0.01 < np.std(error) < 0.25, "a consumer's matcher is coarser than correlation"
    assert abs(error.mean()) < 0.05


def test_properties_strictness_removes(seen: Any) -> None:
    _, left, right, _ = seen(Sphere(0.009))
    cut = slice(90, 150), slice(80, 240)
    loose, strict = (
        match_census(left[cut], right[cut], BOUNDS, CensusSettings(uniqueness=u)) for u in (0, 0.3)
    )
    assert 50 < strict.matched.sum() < loose.matched.sum()
    assert np.isnan(loose.disparity[~loose.matched]).all()
