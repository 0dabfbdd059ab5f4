"""Skin of people: tones uniform in typology angle, zones that differ as they do in hands."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.sampling.appearance import ITA_DEG, linear_rgb_from_lab, sample_skin
from synthgen.sampling.colour import lab_from_xyz, typology_angle, xyz_from_linear_rgb
from synthgen.sampling.streams import stream
from synthgen.scene import Skin

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def people(count: int, tones: tuple[float, float] = (0.0, 1.0)) -> list[tuple[Skin, float]]:
    rng = stream(0, "subject", 1, 0, "skin")
    return [sample_skin(tones, rng=rng) for _ in range(count)]


def lab_of(rgb: tuple[float, float, float]) -> np.ndarray:
    return lab_from_xyz(xyz_from_linear_rgb(np.array(rgb)))


def luminance_at(tone: float, part: str) -> float:
    draws = [skin for skin, _ in people(50, (tone, tone))]
    return float(np.mean([LUMINANCE @ np.array(getattr(skin, part)) for skin in draws]))


def test_reference_lab_known_colours() -> None:
    white, black, grey = np.array([[100.0, 0, 0], [0, 0, 0], [53.585, 0, 0]])
    np.testing.assert_allclose(linear_rgb_from_lab(white), 1.0, atol=2e-4)
    np.testing.assert_allclose(linear_rgb_from_lab(black), 0.0, atol=1e-6)
    np.testing.assert_allclose(linear_rgb_from_lab(grey), 0.2159, atol=5e-4)  # sRGB 128


def test_reference_lab_there_and_back() -> None:
    lab = np.array([[60.0, 14.0, 17.0], [30.0, 9.0, 12.0]])
    np.testing.assert_allclose(lab_of(linear_rgb_from_lab(lab)), lab, atol=1e-3)


def test_properties_the_tone_is_the_typology_angle() -> None:
    for skin, tone in people(60):
        wanted = ITA_DEG[0] + tone * (ITA_DEG[1] - ITA_DEG[0])
        assert typology_angle(lab_of(skin.dorsal_rgb)) == pytest.approx(wanted, abs=0.1)


def test_properties_angles_are_uniform_over_the_human_range() -> None:
    angles = np.array([typology_angle(lab_of(skin.dorsal_rgb)) for skin, _ in people(600)])
    counts, _ = np.histogram(angles, bins=6, range=(ITA_DEG[1], ITA_DEG[0]))
    assert counts.sum() == 600
    assert counts.min() > 70
    assert counts.max() < 135


def test_properties_darker_tone_is_darker() -> None:
    levels = [luminance_at(t, "dorsal_rgb") for t in np.linspace(0, 1, 9)]
    assert np.all(np.diff(levels) < 0)


def test_properties_palm_is_lighter_in_dark_skin() -> None:
    assert luminance_at(1.0, "palm_rgb") > 2 * luminance_at(1.0, "dorsal_rgb")
    for skin, _ in people(100):
        if skin.melanin > 0.03:
            assert lab_of(skin.palm_rgb)[0] > lab_of(skin.dorsal_rgb)[0]


def test_properties_nail_beds_follow_the_tone_without_looking_varnished() -> None:
    for skin, _ in people(100):
        nail, dorsal = lab_of(skin.nail_rgb), lab_of(skin.dorsal_rgb)
        assert nail[1] > dorsal[1] - 1  # redder
        assert nail[0] < dorsal[0] + 25


def test_properties_skin_is_red_over_green_over_blue() -> None:
    for skin, tone in people(100):
        for colour in (skin.dorsal_rgb, skin.palm_rgb, skin.nail_rgb):
            assert 1 > colour[0] > colour[1] > colour[2] > 0, (tone, colour)


def test_properties_freckles_belong_to_light_skin() -> None:
    assert max(skin.freckles for skin, tone in people(200) if tone > 0.5) <= 0.02


def test_edge_fixed_tone() -> None:
    _, tone = people(1, (0.3, 0.3))[0]
    assert tone == pytest.approx(0.3)
