"""Albedo of people from the maps of a topology."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.models import load
from synthgen.render.skin.albedo import albedo
from synthgen.render.skin.bake import SkinMaps, bake
from synthgen.sampling.appearance import sample_skin
from synthgen.sampling.colour import lab_from_xyz, typology_angle, xyz_from_linear_rgb
from synthgen.sampling.spectrum import skin_rgb
from synthgen.sampling.streams import stream
from synthgen.scene import Skin

SIZE = 256
TONES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)


@pytest.fixture(scope="module")
def maps() -> SkinMaps:
    return bake(load("cc0-hand"), SIZE)


def person(tone: float, **changes: object) -> Skin:
    skin, _ = sample_skin((tone, tone), rng=stream(4, "subject", 0, 0, "skin"))
    return replace(skin, **changes)  # type: ignore[arg-type]


def lab_where(maps: SkinMaps, skin: Skin, where: np.ndarray) -> np.ndarray:
    own = albedo(maps, skin)[where[maps.fill]].astype(np.float64)
    return np.asarray(lab_from_xyz(xyz_from_linear_rgb(own.mean(axis=0))))


def zones(maps: SkinMaps) -> dict[str, np.ndarray]:
    plain = (maps.tint < 0.1) & (maps.plate < 0.01) & (maps.vein < 0.1) & (maps.knuckle < 0.1)
    return {
        "dorsal": plain & (maps.palm < 0.01) & (maps.inner < 0.05) & (maps.cuticle < 0.01),
        "palm": plain & (maps.palm > 0.98),
        "knuckle": (maps.knuckle > 0.7) & (maps.tint < 0.3) & (maps.cuticle < 0.01),
        "inner": (maps.inner > 0.9) & (maps.palm < 0.05) & (maps.vein < 0.1),
        "nail": (maps.plate > 0.98) & (maps.nail_along < 0.5) & (maps.nail_along > -0.4),
    }


def test_smoke_shape(maps: SkinMaps) -> None:
    picture = albedo(maps, person(0.3))
    assert picture.shape == (SIZE, SIZE, 3)
    assert picture.dtype == np.float32
    assert 0.003 < picture.min() <= picture.max() <= 0.95


@pytest.mark.parametrize("tone", TONES)
def test_reference_even_skin_has_the_persons_own_colour(maps: SkinMaps, tone: float) -> None:
    """Without mottle the table gives what the spectral model gives, to half a unit of Lab."""
    skin = person(tone, mottle=0.0, freckles=0.0, veins=0.0, creases=0.0)
    wanted = skin_rgb(skin.melanin, skin.blood, skin.eumelanin, skin.carotene)
    wanted_lab = lab_from_xyz(xyz_from_linear_rgb(wanted))
    found = lab_where(maps, skin, zones(maps)["dorsal"] & (maps.cell < 0.02))
    assert np.linalg.norm(found - wanted_lab) < 1.5


@pytest.mark.parametrize("tone", TONES)
def test_properties_mottle_keeps_the_mean(maps: SkinMaps, tone: float) -> None:
    skin = person(tone)
    found = lab_where(maps, skin, zones(maps)["dorsal"])
    angle = typology_angle(found)
    assert angle == pytest.approx(60 - 126 * tone, abs=8)


def test_properties_typology_angle_is_monotone_in_melanin(maps: SkinMaps) -> None:
    base = person(0.4)
    where = zones(maps)["dorsal"]
    angles = [
        float(typology_angle(lab_where(maps, replace(base, melanin=m), where)))
        for m in (0.01, 0.03, 0.06, 0.12, 0.24)
    ]
    assert np.all(np.diff(angles) < 0)


def test_properties_zones_differ_as_in_people(maps: SkinMaps) -> None:
    z = zones(maps)
    light, dark = person(0.1), person(0.9)
    palm, dorsal = lab_where(maps, dark, z["palm"]), lab_where(maps, dark, z["dorsal"])
    assert palm[0] > dorsal[0] + 15
    assert lab_where(maps, dark, z["knuckle"])[0] < dorsal[0]
    assert lab_where(maps, dark, z["inner"])[0] > dorsal[0]
    nail = lab_where(maps, dark, z["nail"])
    assert dorsal[0] + 2 < nail[0] < palm[0] + 2
    light_palm, light_dorsal = (lab_where(maps, light, z[k]) for k in ("palm", "dorsal"))
    assert light_palm[1] > light_dorsal[1] + 1.5
    assert lab_where(maps, light, z["knuckle"])[1] > light_dorsal[1] + 0.5


def test_properties_every_ingredient_can_be_left_away(maps: SkinMaps) -> None:
    full = person(0.2, freckles=0.3)
    whole = albedo(maps, full)
    for name in ("mottle", "freckles", "veins", "creases"):
        without = albedo(maps, replace(full, **{name: 0.0}))
        assert np.abs(whole - without).max() > 0.01, name


def test_properties_veins_do_not_show_in_very_dark_skin(maps: SkinMaps) -> None:
    skin = person(1.0, veins=1.0)
    np.testing.assert_allclose(
        albedo(maps, skin), albedo(maps, replace(skin, veins=0.0)), atol=1e-6
    )


def test_properties_varnish_paints_nails_alone(maps: SkinMaps) -> None:
    skin = person(0.5)
    painted = replace(skin, varnish_rgb=(0.42, 0.012, 0.02))
    changed = np.abs(albedo(maps, painted) - albedo(maps, skin)).max(axis=-1) > 1e-6
    plate = maps.plate[maps.fill] > 0.004
    assert changed[plate].mean() > 0.8
    assert not changed[~plate].any()


def test_edge_seeds_move_the_freckles(maps: SkinMaps) -> None:
    skin = person(0.1, freckles=0.3)
    assert not np.array_equal(albedo(maps, skin), albedo(maps, replace(skin, seed=skin.seed + 1)))
