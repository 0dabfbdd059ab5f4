"""Solid noise: a function of place, of unit deviation, with the wavelength asked for."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.render.skin.noise import _trilinear, _volume, solid_noise
from synthgen.sampling.streams import stream


def places(count: int = 20_000) -> np.ndarray:
    return stream(1, "sample", 0, 0, "places").uniform(-0.2, 0.2, (count, 3)).astype(np.float32)


def test_smoke_shape() -> None:
    assert solid_noise(places(10), 0.01, "a", 3).shape == (10,)


@pytest.mark.parametrize("octaves", [1, 3])
def test_reference_zero_mean_unit_deviation(octaves: int) -> None:
    values = solid_noise(places(), 0.004, "b", octaves)
    assert abs(values.mean()) < 0.1
    assert values.std() == pytest.approx(1, abs=0.25)


def test_reference_trilinear_is_scipys() -> None:
    from scipy import ndimage

    where = stream(2, "sample", 0, 0, "where").uniform(-60, 60, (500, 3)).astype(np.float32)
    volume = _volume("c/0")
    wanted = ndimage.map_coordinates(
        volume.astype(np.float64), where.T.astype(np.float64), order=1, mode="grid-wrap"
    )
    np.testing.assert_allclose(_trilinear(volume, where), wanted, atol=2e-4)


def test_properties_near_places_agree_and_far_ones_do_not() -> None:
    p = places(3000)
    here = solid_noise(p, 0.02, "d")
    near = solid_noise(p + np.float32(2e-4), 0.02, "d")
    far = solid_noise(p + np.float32(0.031), 0.02, "d")
    assert np.corrcoef(here, near)[0, 1] > 0.98
    assert abs(np.corrcoef(here, far)[0, 1]) < 0.2


def test_properties_names_are_different_functions() -> None:
    p = places(3000)
    a, b = solid_noise(p, 0.01, "e"), solid_noise(p, 0.01, "f")
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.2
    np.testing.assert_array_equal(a, solid_noise(p, 0.01, "e"))
