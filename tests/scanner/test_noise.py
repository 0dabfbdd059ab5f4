"""The noise model: what is fitted to its own samples comes back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from synthgen.errors import ConfigError, ShapeError
from synthgen.sampling.streams import stream
from synthgen.scanner.noise import DARKEST, NoiseModel, add_noise, edge_bin, load_noise, slope_bin
from synthgen.scanner.noise_fit import fit_noise

MODEL = NoiseModel(
    step=3,
    sigma_px=(0.02, 0.03, 0.04, 0.06, 0.1),
    wild_share=0.01,
    wild_factor=4.0,
    correlation_px=4.5,
    smooth_px=0.0,
    edge_share=(0.2, 0.6, 0.9, 1.0, 1.0, 1.0),
    slope_share=(0.99, 0.99, 0.98, 0.95, 0.8),
)


def dome(seed: int) -> Any:
    """Disparities of a dome on nothing: every slope, an edge all around."""
    y, x = np.mgrid[-100:101, -120:121] * 3.0
    under = 1 - (x / 330) ** 2 - (y / (270 + 10 * seed)) ** 2
    return np.where(under > 0.02, 120 * np.sqrt(np.maximum(under, 0)), np.nan).astype(np.float32)


@pytest.fixture(scope="module")
def pairs() -> Any:
    rng = stream(0, "sample", 0, 0, "noise")
    ideals = [dome(k) for k in range(3)]
    return [(add_noise(d, 3, (603, 723), MODEL, rng=rng).disparity, d) for d in ideals]


def test_reference_fit_finds_its_own_model(pairs: Any) -> None:
    found = fit_noise(pairs, 3)
    assert found.sigma_px == pytest.approx(MODEL.sigma_px, rel=0.12)
    assert found.correlation_px == pytest.approx(MODEL.correlation_px, rel=0.12)
    # Luck is correlated over windows: shares are known to a few percent only.
    assert found.edge_share == pytest.approx(MODEL.edge_share, abs=0.1)
    assert found.slope_share == pytest.approx(MODEL.slope_share, abs=0.06)
    assert found.smooth_px <= 1.0


def test_reference_fit_finds_wild_long_and_dark_parts() -> None:
    """Errors of a tenth of the samples four times as large, a long part, darker is worse."""
    hard = MODEL.model_copy(
        update={"wild_share": 0.12, "long_part": 0.5, "long_px": 45.0, "albedo": 0.2,
                "albedo_power": 0.4}
    )  # fmt: skip
    rng = stream(1, "sample", 0, 0, "noise")
    albedo = [0.05, 0.1, 0.4, 0.8] * 2
    made = []
    for k, tone in enumerate(albedo):
        ideal = dome(k)
        grid = add_noise(ideal, 3, (603, 723), hard, rng=rng, strength=hard.strength(tone))
        made.append((grid.disparity, ideal))
    found = fit_noise(made, 3, albedo)
    assert found.albedo == pytest.approx(0.2, rel=1e-3)
    assert found.albedo_power == pytest.approx(0.4, abs=0.08)
    assert found.sigma_px[0] == pytest.approx(hard.sigma_px[0], rel=0.25)
    assert found.wild_share * (found.wild_factor**2 - 1) == pytest.approx(0.12 * 15, rel=0.3)
    assert found.long_part == pytest.approx(0.5, abs=0.15)
    assert found.correlation_px == pytest.approx(4.5, rel=0.2)


def test_properties_strength() -> None:
    dark = MODEL.model_copy(update={"albedo": 0.3, "albedo_power": 0.3})
    assert dark.strength(0.3) == 1.0
    assert dark.strength(0.05) > 1.5
    assert dark.strength(0.0) < 3
    assert MODEL.strength(0.01) == 1.0
    grids = [
        add_noise(dome(0), 3, (603, 723), dark, rng=stream(2, "sample", 0, 0, "n"),
                  strength=dark.strength(albedo))
        for albedo in (0.6, 0.05)
    ]  # fmt: skip
    errors = [np.nanstd(grid.disparity - dome(0)) for grid in grids]
    assert errors[1] > 1.8 * errors[0]
    assert grids[1].matched.sum() < grids[0].matched.sum()


def test_properties_noise_is_one_error_within_a_window(pairs: Any) -> None:
    measured, ideal = pairs[0]
    flat = np.where(slope_bin(ideal, 3) == 0, measured - ideal, np.nan)
    flat = flat[60:140, 60:180]
    near = np.nanmean(flat[:, 1:] * flat[:, :-1]) / np.nanvar(flat)
    far = np.nanmean(flat[:, 10:] * flat[:, :-10]) / np.nanvar(flat)
    assert near > 0.8
    assert abs(far) < 0.3


def test_properties_same_stream_same_noise() -> None:
    made = [
        add_noise(dome(0), 3, (603, 723), MODEL, rng=stream(1, "sample", 0, 0, "n")).disparity
        for _ in range(2)
    ]
    assert made[0].tobytes() == made[1].tobytes()


def test_properties_black_skin_is_as_dark_as_can_be(pairs: Any) -> None:
    albedo = [0.0, 0.3, 0.3]
    assert fit_noise(pairs, 3, albedo) == fit_noise(pairs, 3, [DARKEST, 0.3, 0.3])


def test_reference_bins() -> None:
    known = np.ones((9, 9), bool)
    known[:, 0] = False
    assert edge_bin(known, 4)[4, :6].tolist() == [0, 0, 1, 2, 3, 3]
    ramp = np.tile(np.arange(20, dtype=np.float32) * 0.25 * 3, (20, 1))
    assert (slope_bin(ramp, 3) == 2).all()


def test_edge_bad_input() -> None:
    nothing = np.full((40, 40), np.nan, np.float32)
    with pytest.raises(ShapeError, match="too few"):
        fit_noise([(nothing, nothing)], 3)
    ideal = dome(0)
    same = [(ideal + np.float32(0.01) * (k + 1), ideal) for k in range(2)]
    for pairs, step, albedo, words in (
        (same, 3, [0.1], r"albedo = \[0\.1\] for 2 pairs; give one"),
        (same, 3, [0.1, -0.2], "reflectance 0..1 a pair"),
        (same, 3, [np.nan, 0.2], "reflectance 0..1 a pair"),
        (same, 0, None, "step = 0; 1 to 16"),
        ([(ideal[:9, :9], ideal[:9, :9])], 3, None, "at least 32 x 32"),
        ([(ideal[:50], ideal)], 3, None, r"pair 0: grids of shapes \(50, 241\) and \(201, 241\)"),
        ([(ideal, ideal)], 3, None, "median .* is 0 px"),
        ([(ideal + np.float32(7), ideal)], 3, None, "median .* is 7 px"),
    ):
        with pytest.raises(ShapeError, match=words):
            fit_noise(pairs, step, albedo)
    with pytest.raises(ShapeError, match="2 x 2 or more"):
        add_noise(ideal[:1, :1], 3, (3, 3), MODEL, rng=stream(0, "sample", 0, 0, "n"))
    with pytest.raises(ShapeError, match=r"default_rng\(0\)"):
        add_noise(ideal, 3, (603, 723), MODEL, rng=0)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="no noise model"):
        load_noise("hnd5")
