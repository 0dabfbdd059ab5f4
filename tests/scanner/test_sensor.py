"""The sensor: each effect alone, measured from its counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.geometry.cameras import camera_from_K
from synthgen.sampling.streams import stream
from synthgen.scanner.rig import Sensor
from synthgen.scanner.sensor import (
    SENSOR_EFFECTS,
    automatic_gain,
    counts,
    fixed_pattern,
    optical,
    without,
)
from tests.scanner.small import mini, quiet

H, W = 200, 300
STILL = quiet(mini()).grey
FLAT = np.full((H, W), 0.5, np.float32)


def taken(
    sensor: Sensor, picture: np.ndarray = FLAT, seed: int = 0, gain: float = 1.0
) -> np.ndarray:
    fixed = fixed_pattern(7, 0, *picture.shape, sensor.prnu, sensor.hot_share)
    return counts(picture, sensor, gain, fixed, rng=stream(seed, "sample", 0, 0, "sensor"))


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (10, np.uint16), (12, np.uint16)])
def test_smoke_everything_off_is_the_picture(bits: int, dtype: type) -> None:
    sensor = replace(STILL, bits=bits)
    got = taken(sensor)
    assert got.dtype == dtype
    assert (got == round(0.5 * (2**bits - 1))).all() or np.ptp(got) == 0
    assert abs(float(got[0, 0]) - 0.5 * (2**bits - 1)) <= 0.5


def test_reference_shot_noise_follows_the_full_well() -> None:
    for well in (1000.0, 20_000.0):
        got = taken(replace(STILL, shot_noise=True, full_well_e=well)).astype(float)
        assert got.mean() / 4095 == pytest.approx(0.5, abs=0.002)
        expected = np.sqrt((np.sqrt(0.5 * well) / well * 4095) ** 2 + 1 / 12)
        assert got.std() == pytest.approx(expected, rel=0.03)


def test_reference_read_noise_and_black_level() -> None:
    dark = taken(replace(STILL, read_noise_e=20.0, black_dn=8.0), np.zeros((H, W), np.float32))
    assert dark.mean() == pytest.approx(8 * 4095 / 255, abs=0.5)
    assert dark.std() == pytest.approx(20 / STILL.full_well_e * 4095, rel=0.03)


def test_properties_gains_are_frozen_noise_is_not() -> None:
    sensor = replace(STILL, prnu=0.02)
    a, b = taken(sensor, seed=0), taken(sensor, seed=1)
    assert np.array_equal(a, b)
    assert a.std() / a.mean() == pytest.approx(0.02, rel=0.05)
    noisy = replace(sensor, shot_noise=True)
    a, b = (taken(noisy, seed=s).astype(float) for s in (0, 1))
    assert not np.array_equal(a, b)
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.5


def test_properties_hot_pixels() -> None:
    got = taken(replace(STILL, hot_share=0.01), np.zeros((H, W), np.float32))
    assert (got > 0).mean() == pytest.approx(0.01, rel=0.3)
    assert got[got > 0].min() > 0.19 * 4095
    again = taken(replace(STILL, hot_share=0.01), np.zeros((H, W), np.float32), seed=9)
    assert np.array_equal(got, again)


def test_properties_saturation() -> None:
    got = taken(STILL, np.full((H, W), 3.0, np.float32))
    assert (got == 4095).all()


@pytest.mark.parametrize("effect", SENSOR_EFFECTS)
def test_properties_one_effect_less_leaves_the_others_their_numbers(effect: str) -> None:
    """What differs is what the effect made: nothing else is drawn anew."""
    sensor = replace(
        STILL, shot_noise=True, read_noise_e=20.0, prnu=0.02, hot_share=0.01, bits=8, black_dn=8.0
    )
    rig = without(replace(mini(), grey=sensor), [effect])
    with_, less = (
        taken(s, np.linspace(0, 1.5, H * W, dtype=np.float32).reshape(H, W)).astype(np.float64)
        for s in (sensor, rig.grey)
    )
    differs = with_ != less
    largest = {"quantisation": 0.5, "shot_noise": 15, "read_noise": 15, "pixel_gains": 30}
    assert differs.any()
    assert np.abs(with_ - less).max() <= largest.get(effect, np.inf) + 1e-4
    if effect == "saturation":
        assert (with_[differs] >= 254).mean() > 0.98  # the rest: hot pixels
        assert less.max() > 1.4 * 255
    if effect == "hot_pixels":
        assert differs.mean() < 0.011
    assert rig.grey != sensor
    assert without(rig, [effect]) == rig


def test_properties_blur_and_vignetting() -> None:
    camera = camera_from_K(np.array([[200.0, 0, 149.5], [0, 200, 99.5], [0, 0, 1]]), W, H)
    point = np.zeros((H, W), np.float32)
    point[100, 150] = 1
    blurred = optical(point, replace(STILL, psf_px=1.5), camera)
    x = np.arange(W) - 150
    assert blurred.sum() == pytest.approx(1, abs=1e-4)
    assert np.sqrt((blurred.sum(axis=0) * x * x).sum()) == pytest.approx(1.5, rel=0.03)
    dim = optical(FLAT, replace(STILL, vignetting=4.0), camera)
    corner = 1 / np.hypot(1, np.hypot(149.5, 99.5) / 200)
    assert dim[0, 0] / FLAT[0, 0] == pytest.approx(corner**4, rel=1e-3)


def test_properties_automatic_gain() -> None:
    rng = stream(0, "sample", 0, 0, "x")
    picture = rng.uniform(0.01, 0.02, (H, W)).astype(np.float32)
    gain = automatic_gain([picture, picture], 0.002, 0.8)
    assert gain is not None
    assert np.quantile(picture * gain, 0.99) == pytest.approx(0.8, rel=0.01)
    assert automatic_gain([np.full((H, W), 0.002, np.float32)], 0.002, 0.8) is None
