"""The skin model: known limits, band counts, the hue curve of people."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.sampling.appearance import sample_skin
from synthgen.sampling.colour import lab_from_xyz, typology_angle, xyz_from_linear_rgb
from synthgen.sampling.spectrum import bands, reflectance, skin_lab, skin_xyz
from synthgen.sampling.streams import stream

MELANIN = np.geomspace(0.003, 0.35, 40)
# Class by ITA, degrees: bounds of L*, a*, b* that published measurements of hands and arms span.
BOXES = {
    (55, 90): ((63, 76), (6, 15), (7, 18)),
    (41, 55): ((60, 72), (6, 16), (9, 20)),
    (28, 41): ((56, 68), (7, 17), (11, 22)),
    (10, 28): ((50, 62), (8, 18), (13, 24)),
    (-30, 10): ((35, 55), (9, 19), (12, 25)),
    (-90, -30): ((20, 42), (5, 18), (6, 22)),
}


def test_smoke_shapes() -> None:
    table = bands()
    assert table.wavelength_nm.shape == (31,)
    assert bands(16).wavelength_nm.tolist() == list(range(400, 701, 20))
    assert reflectance(0.03, np.full((4, 5), 0.02), 0.8, 1.0).shape == (4, 5, 31)


@pytest.mark.parametrize("count", [16, 31])
def test_reference_a_perfect_reflector_is_white(count: int) -> None:
    white = np.ones(count) @ bands(count).to_xyz
    np.testing.assert_allclose(lab_from_xyz(white), [100, 0, 0], atol=1e-4)


def test_reference_blood_has_its_two_dips_in_green_and_yellow() -> None:
    """Oxyhaemoglobin absorbs at 542 and 577 nm, less between them."""
    r = dict(zip(bands().wavelength_nm, reflectance(0.005, 0.03, 0.6, 1.0), strict=True))
    assert r[540] < r[560] > r[580]
    assert r[650] > 1.5 * r[580]


def test_properties_16_bands_are_31() -> None:
    for carotene in (0.8, 2.0, 4.0):
        many = skin_lab(MELANIN, 0.02, 0.8, carotene)
        few = skin_lab(MELANIN, 0.02, 0.8, carotene, bands(16))
        assert np.linalg.norm(many - few, axis=1).max() < 0.3


def test_properties_typology_angle_falls_with_melanin() -> None:
    for blood in (0.012, 0.02, 0.03):
        for eumelanin in (0.55, 0.8, 0.95):
            assert np.all(np.diff(typology_angle(skin_lab(MELANIN, blood, eumelanin, 1.4))) < 0)


def test_properties_yellow_rises_and_falls() -> None:
    """b* over lightness is a hump: highest in brown skin, low in very dark skin."""
    lab = skin_lab(MELANIN, 0.02, np.interp(MELANIN, [0.006, 0.05, 0.2], [0.55, 0.85, 0.95]), 1.4)
    peak = int(lab[:, 2].argmax())
    assert 40 < lab[peak, 0] < 60
    assert lab[0, 2] < lab[peak, 2] - 5
    assert lab[-1, 2] < lab[peak, 2] - 5


def test_properties_blood_reddens() -> None:
    a = skin_lab(0.02, np.linspace(0.01, 0.06, 8), 0.8, 1.4)[:, 1]
    assert np.all(np.diff(a) > 0)


@pytest.mark.parametrize(("low", "high"), list(BOXES))
def test_properties_every_tone_in_its_lab_box(low: int, high: int) -> None:
    rng = stream(3, "subject", 0, 0, "skin")
    found = []
    for _ in range(300):
        skin, _ = sample_skin((0.0, 1.0), rng=rng)
        lab = lab_from_xyz(xyz_from_linear_rgb(np.array(skin.dorsal_rgb)))
        if low < typology_angle(lab) <= high:
            found.append(lab)
    assert len(found) > 3
    for column, (least, most) in zip(np.array(found).T, BOXES[low, high], strict=True):
        assert least <= column.min() <= column.max() <= most


def test_edge_no_pigment_is_bright_and_much_is_not_black() -> None:
    assert skin_xyz(0.002, 0.002, 0.5, 0.0)[1] > 0.45
    assert 0.015 < skin_xyz(0.45, 0.02, 1.0, 1.0)[1] < 0.05
