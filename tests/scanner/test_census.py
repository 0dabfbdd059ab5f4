"""The consumer matcher."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from speckle import Plane, Sphere

from synthgen.sampling.streams import stream
from synthgen.scanner.census import CensusSettings, census, match_census
from synthgen.scanner.pattern import slide
from synthgen.scanner.rig import Pattern

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


@pytest.mark.parametrize("fraction", [0.2, 0.3, 0.4, 0.6, 0.7, 0.8])
def test_properties_fractions_are_found(fraction: float) -> None:
    """Penalties stand against costs summed over the block; against their mean all snaps to pixels.

    A parabola through the costs would leave .05 to .09.
    """
    texture = 30 + 150 * slide(Pattern("speckle", 4.0, 0.5, 5), 160)
    rng = stream(0, "sample", 0, 0, "noise")
    y, x = np.indices((80, 120), dtype=np.float32) + np.float32(20)
    left, right = (
        cv2.remap(texture, x + np.float32(shift), y, cv2.INTER_LANCZOS4)
        for shift in (0, 3 + fraction)
    )
    noisy = [picture + 2 * rng.standard_normal(picture.shape) for picture in (left, right)]
    error = match_census(noisy[0], noisy[1], (-5.0, 12.0)).disparity - (3 + fraction)
    assert abs(np.nanmedian(error[10:-10, 20:-10])) < 0.04


def test_properties_strictness_removes(seen: Any) -> None:
    _, left, right, _ = seen(Sphere(0.009))
    cut = slice(90, 150), slice(80, 240)
    loose, strict = (
        match_census(left[cut], right[cut], BOUNDS, CensusSettings(uniqueness=u)) for u in (0, 0.3)
    )
    assert 50 < strict.matched.sum() < loose.matched.sum()
    assert np.isnan(loose.disparity[~loose.matched]).all()
