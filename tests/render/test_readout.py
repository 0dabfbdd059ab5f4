"""The sensor-noise model that scanners and views share: its effects, and that they share it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.render.readout import Readout, counts, draw_pattern, electrons
from synthgen.render.sensor import read_out
from synthgen.sampling.streams import stream
from synthgen.scanner import load_rig
from synthgen.scanner import sensor as scanner_sensor
from synthgen.scene import Sensor

H, W = 120, 160
QUIET = Readout(10_000.0, shot_noise=False)


def rng(seed: int = 0) -> np.random.Generator:
    return stream(seed, "sample", 0, 0, "sensor noise")


def light(channels: int = 1) -> np.ndarray:
    values = rng(9).uniform(0.05, 0.7, (H, W, channels)).astype(np.float32)
    return values[..., 0] if channels == 1 else values


def test_smoke_everything_off_is_proportional() -> None:
    held = electrons(light(), QUIET, 0.5, rng=rng())
    np.testing.assert_allclose(held, 5000 * light(), rtol=1e-6)
    assert held.dtype == np.float32
    assert electrons(light().astype(np.float64), QUIET, rng=rng()).dtype == np.float64


def test_reference_views_and_scanners_read_identical_numbers() -> None:
    """One stream, one light, both paths with the same well and read noise: equal counts."""
    rig = load_rig("mini")
    theirs = replace(rig.grey, prnu=0.0, hot_share=0.0, bits=12, black_dn=0.0)
    fixed = scanner_sensor.fixed_pattern(0, 0, H, W, 0.0, 0.0)
    scanned = scanner_sensor.counts(light(), theirs, 1.0, fixed, rng=rng())
    view = Sensor(full_well=theirs.full_well_e, read_e=theirs.read_noise_e)
    viewed = read_out(light(), view, rng=rng())
    assert np.array_equal(np.rint(viewed * 4095).astype(np.uint16), scanned)
    assert scanned.std() > 0.01 * 4095


def test_reference_variance_is_electrons_plus_read_noise() -> None:
    flat = np.full((400, 400), 0.3)
    noisy = electrons(flat, Readout(2000.0, read_noise_e=15.0), rng=rng())
    assert noisy.std() == pytest.approx(np.sqrt(600 + 15**2), rel=0.01)
    assert noisy.mean() == pytest.approx(600, abs=0.3)
    still = electrons(flat, Readout(2000.0, shot_noise=False, read_noise_e=15.0), rng=rng())
    assert still.std() == pytest.approx(15, rel=0.01)


def test_properties_fixed_pattern_gain_and_hot_pixels() -> None:
    fixed = draw_pattern(H, W, 0.02, 0.01, rng=rng(4))
    flat = np.full((H, W), 0.1, np.float32)
    got = electrons(flat, replace(QUIET, prnu=0.02, hot_share=0.01), 1.0, fixed, rng=rng())
    hot = np.zeros(H * W, bool)
    hot[fixed.hot] = True
    assert got.ravel()[hot].min() > 1500
    cold = got.ravel()[~hot]
    np.testing.assert_allclose(cold, 1000 * fixed.gain.ravel()[~hot], rtol=1e-5)
    assert cold.std() / cold.mean() == pytest.approx(0.02, rel=0.05)
    columns = np.asfortranarray(flat)
    again = electrons(columns, replace(QUIET, prnu=0.02, hot_share=0.01), 1.0, fixed, rng=rng())
    np.testing.assert_array_equal(again, got)


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_properties_saturation_and_quantisation(bits: int) -> None:
    model = replace(QUIET, bits=bits, black_dn=2.0)
    got = counts(electrons(np.array([[-1.0, 0.0, 0.5, 3.0]]), model, rng=rng()), model)
    full = 2**bits - 1
    black = 2 * full / 255
    assert got.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert got.tolist() == [[round(black), round(black), round(0.5 * full + black), full]]
    wide = replace(model, saturation=np.inf)
    held = electrons(np.array([[-1.0, 3.0]]), wide, rng=rng())
    assert held[0, 1] == pytest.approx(30_000)
    assert counts(held, wide).tolist() == [[round(black), round(3 * full + black)]]
    assert counts(held, wide).dtype == np.uint16
    for fine, most in (
        (replace(model, quantisation=False), full),
        (replace(wide, quantisation=False), 3 * full + black),
    ):
        got = counts(electrons(np.array([[0.3, 3.0]]), fine, rng=rng()), fine)
        assert got.dtype == np.float32
        assert got.tolist()[0] == pytest.approx([0.3 * full + black, most])


def test_properties_same_stream_same_numbers() -> None:
    model = Readout(1000.0, read_noise_e=5.0)
    a, b, c = (electrons(light(3), model, rng=rng(seed)) for seed in (0, 0, 1))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
