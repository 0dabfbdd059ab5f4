"""The sensor against what its parts must do, one by one."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.render.sensor import balance_of, demosaic, develop, exposure_of, mosaic
from synthgen.scene import Sensor

GREY = np.full((96, 96, 3), 0.2, np.float32)
PLAIN = Sensor()


def ramp() -> np.ndarray:
    x = np.linspace(0.05, 0.9, 96)
    return np.broadcast_to(x[None, :, None], (96, 96, 3)).astype(np.float32).copy()


def test_smoke_grey_becomes_middle_grey() -> None:
    for level in (0.01, 0.2, 30.0):
        image, exposure = develop(np.full((32, 32, 3), level), PLAIN)
        assert exposure == pytest.approx(0.2 / level, rel=1e-6)
        assert set(np.unique(image)) == {124}  # sRGB of 0.2


def test_properties_exposure_error_is_in_stops() -> None:
    base = develop(GREY, PLAIN)[1]
    assert develop(GREY, Sensor(exposure_ev=1.0))[1] == pytest.approx(2 * base)


def test_properties_highlights_bound_the_exposure() -> None:
    bright = np.full((50, 50, 3), 0.001)
    bright[:, :5] = 100.0
    assert exposure_of(bright) * 100.0 <= 1.15 + 1e-9


def test_reference_noise_has_the_variance_of_photons_and_read_noise() -> None:
    """Far below the curve's knee, through the inverse of its slope, on a flat grey."""
    well, read = 900.0, 12.0
    flat = np.full((300, 300, 3), 0.2)
    sensor = Sensor(full_well=well, read_e=read, seed=5)
    image, _ = develop(flat, sensor)
    slope = 255 * 1.055 / 2.4 * 0.2 ** (1 / 2.4 - 1)
    wanted = slope * np.sqrt(0.2 * well + read**2) / well
    assert image.std() == pytest.approx(wanted, rel=0.03)
    again, _ = develop(flat, sensor)
    other, _ = develop(flat, sensor, view=1)
    assert np.array_equal(image, again)
    assert not np.array_equal(image, other)


def test_reference_balance_amplifies_noise() -> None:
    """Photons are counted before a channel is lifted: as many electrons, twice the noise."""
    well, read, gains = 900.0, 12.0, np.array([2.0, 1.0, 0.5])
    flat = np.full((300, 300, 3), 0.1)
    sensor = Sensor(balance_error=tuple(gains), full_well=well, read_e=read, exposure_ev=-1.0)
    image, exposure = develop(flat, sensor)
    level = 0.1 * exposure
    slope = 255 * 1.055 / 2.4 * (level * gains) ** (1 / 2.4 - 1)
    wanted = slope * gains * np.sqrt(level * well + read**2) / well
    np.testing.assert_allclose(image.std(axis=(0, 1)), wanted, rtol=0.06)


def test_reference_white_balance_takes_the_light_out() -> None:
    light = np.array([1.4, 1.0, 0.6])
    albedo = np.random.Generator(np.random.Philox(1)).uniform(0.1, 0.8, (40, 40, 3))
    linear = (albedo * light).astype(np.float32)
    sensor = Sensor(white_balance=True)
    factors = balance_of(linear, albedo.astype(np.float32), sensor)
    left = light * factors
    assert np.ptp(left) < 0.35 * np.ptp(light)
    assert balance_of(linear, None, sensor).tolist() == [1.0, 1.0, 1.0]
    wrong = Sensor(white_balance=True, balance_error=(1.1, 1.0, 0.9))
    np.testing.assert_allclose(
        balance_of(linear, albedo.astype(np.float32), wrong), factors * [1.1, 1.0, 0.9]
    )


def test_properties_mosaic_keeps_one_channel_and_comes_back() -> None:
    colours = ramp().astype(np.float64) * [1.0, 0.7, 0.4]
    raw = mosaic(colours)
    assert raw[0, 0] == colours[0, 0, 0]
    assert raw[1, 1] == colours[1, 1, 2]
    assert raw[0, 1] == colours[0, 1, 1]
    back = demosaic(raw)
    assert np.abs(back - colours).max() < 0.02
    red = np.zeros((16, 16, 3))
    red[..., 0] = 0.5
    assert demosaic(mosaic(red))[8, 8].argmax() == 0


def test_properties_blur_sharpening_and_bloom() -> None:
    edge = np.full((64, 64, 3), 0.1, np.float32)
    edge[:, 32:] = 0.4

    def step(sensor: Sensor) -> int:
        image, _ = develop(edge, sensor)
        return int(image[32, 33, 1]) - int(image[32, 30, 1])

    sharp, soft, crisp = (step(s) for s in (PLAIN, Sensor(psf_px=1.5), Sensor(sharpen=0.5)))
    assert soft < sharp < crisp
    spot = np.full((256, 256, 3), 0.2, np.float32)
    spot[124:132, 124:132] = 60.0
    plain, glowing = (develop(spot, s)[0] for s in (PLAIN, Sensor(bloom=0.3)))
    assert glowing[128, 134].mean() > plain[128, 134].mean() + 5


def test_edge_black_picture() -> None:
    image, exposure = develop(np.zeros((16, 16, 3)), Sensor(white_balance=True, full_well=1000.0))
    assert np.isfinite(exposure)
    assert image.shape == (16, 16, 3)
