"""Skin colours: a tone scale that runs the right way."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.sampling.appearance import linear_rgb_from_lab, sample_skin
from synthgen.sampling.streams import stream

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def luminance_at(tone: float, part: str) -> float:
    rng = stream(0, "subject", 1, 0, "skin")
    draws = [sample_skin((tone, tone), rng=rng)[0] for _ in range(50)]
    return float(np.mean([LUMINANCE @ np.array(getattr(skin, part)) for skin in draws]))


def test_reference_lab_known_colours() -> None:
    white, black, grey = np.array([[100.0, 0, 0], [0, 0, 0], [53.585, 0, 0]])
    np.testing.assert_allclose(linear_rgb_from_lab(white), 1.0, atol=2e-4)
    np.testing.assert_allclose(linear_rgb_from_lab(black), 0.0, atol=1e-6)
    np.testing.assert_allclose(linear_rgb_from_lab(grey), 0.2159, atol=5e-4)  # sRGB 128


def test_properties_darker_tone_is_darker() -> None:
    levels = [luminance_at(t, "dorsal_rgb") for t in np.linspace(0, 1, 9)]
    assert np.all(np.diff(levels) < 0)


def test_properties_palm_is_lighter_in_dark_skin() -> None:
    assert luminance_at(1.0, "palm_rgb") > 2 * luminance_at(1.0, "dorsal_rgb")


def test_properties_skin_is_red_over_green_over_blue() -> None:
    rng = stream(0, "subject", 2, 0, "skin")
    for _ in range(100):
        skin, tone = sample_skin((0.0, 1.0), rng=rng)
        for colour in (skin.dorsal_rgb, skin.palm_rgb, skin.nail_rgb):
            assert 1 > colour[0] > colour[1] > colour[2] > 0, (tone, colour)


def test_edge_fixed_tone() -> None:
    _, tone = sample_skin((0.3, 0.3), rng=stream(0, "subject", 3, 0, "skin"))
    assert tone == pytest.approx(0.3)
