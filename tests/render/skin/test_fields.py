"""Zones and grain: where the palm ends, what is a knuckle, how fine the texture is."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.models import load
from synthgen.render.skin.fields import FRECKLE_SITES, Grain, Zones, lay_grain, lay_zones
from synthgen.render.skin.sites import Sites, atlas_sites
from synthgen.scene.anatomy import anatomy_of


@pytest.fixture(scope="module")
def laid() -> tuple[Sites, Zones, Grain]:
    model = load("cc0-hand")
    sites, _ = atlas_sites(model, 512)
    zones = lay_zones(sites, anatomy_of(model))
    return sites, zones, lay_grain(sites, zones.palm, np.zeros_like(zones.palm))


def test_smoke_ranges(laid: tuple[Sites, Zones, Grain]) -> None:
    sites, zones, grain = laid
    for name in ("palm", "inner", "knuckle", "tip", "pad", "vein"):
        values = getattr(zones, name)
        assert values.shape == (len(sites.points),)
        assert 0 <= values.min() <= values.max() <= 1
    assert grain.freckle.max() < FRECKLE_SITES
    assert np.abs(grain.relief).max() < 0.4


def test_properties_palms_face_down_and_backs_up(laid: tuple[Sites, Zones, Grain]) -> None:
    sites, zones, _ = laid
    hand = (sites.weights[:, 0] > 0.9) & (sites.points[:, 0] < -0.05)
    assert zones.palm[hand & (sites.normals[:, 1] < -0.6)].min() > 0.8
    assert zones.palm[hand & (sites.normals[:, 1] > 0.4)].max() < 0.05


def test_properties_the_palm_runs_out_softly_at_the_wrist(
    laid: tuple[Sites, Zones, Grain],
) -> None:
    """Over 15-25 mm, not in a line; the arm has none."""
    sites, zones, _ = laid
    under = sites.normals[:, 1] < -0.7
    x = sites.points[:, 0]
    level = [zones.palm[under & (np.abs(x - at) < 0.002)].mean() for at in (-0.035, 0.0, 0.03)]
    assert level[0] > 0.85
    assert 0.1 < level[1] < 0.9
    assert level[2] < 0.02


def test_properties_knuckles_lie_on_backs_of_joints(laid: tuple[Sites, Zones, Grain]) -> None:
    sites, zones, _ = laid
    joints = np.concatenate([f.points[:3] for f in anatomy_of(load("cc0-hand")).fingers])
    strong = zones.knuckle > 0.5
    away = np.linalg.norm(sites.points[strong][:, None] - joints[None], axis=2).min(axis=1)
    assert away.max() < 0.025
    assert zones.palm[strong].max() < 0.5


def test_properties_grain_is_even_noise(laid: tuple[Sites, Zones, Grain]) -> None:
    _, _, grain = laid
    for name in ("big", "middle", "fine", "pigment"):
        values = getattr(grain, name)
        assert values.std() == pytest.approx(1, abs=0.35), name
        assert abs(values.mean()) < 0.6, name
    assert 0.05 < grain.cell.mean() < 0.7
