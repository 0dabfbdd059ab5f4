"""Gloss, and heights that follow the pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.models import load
from synthgen.render.skin.bake import SkinMaps, bake
from synthgen.render.skin.surface import gloss, height_m
from synthgen.sampling.appearance import sample_skin
from synthgen.sampling.streams import stream
from synthgen.scene import Skin

SIZE = 256
PIP = 2  # index finger, middle joint


@pytest.fixture(scope="module")
def maps() -> SkinMaps:
    return bake(load("cc0-hand"), SIZE)


@pytest.fixture(scope="module")
def skin() -> Skin:
    return sample_skin((0.4, 0.4), rng=stream(4, "subject", 0, 0, "skin"))[0]


def relief(maps: SkinMaps, skin: Skin, degrees: float, where: np.ndarray) -> float:
    bent = np.zeros(16)
    bent[PIP] = np.deg2rad(degrees)
    height = height_m(maps, skin, bent)[..., 0] - 1e-3 * maps.still[maps.fill]
    return float(height[where[maps.fill]].std())


def test_smoke_shapes(maps: SkinMaps, skin: Skin) -> None:
    rough, coat = gloss(maps, skin)
    height = height_m(maps, skin, np.zeros(16))
    assert rough.shape == coat.shape == height.shape == (SIZE, SIZE, 1)
    assert 0.1 < rough.min() <= rough.max() < 1
    assert 0 <= coat.min() <= coat.max() <= 1


def test_reference_heights_are_tenths_of_millimetres(maps: SkinMaps, skin: Skin) -> None:
    height = height_m(maps, skin, np.zeros(16))
    assert 5e-5 < np.abs(height).max() < 2.5e-3
    assert height.std() < 2e-4


def test_properties_wrinkles_flatten_and_folds_deepen(maps: SkinMaps, skin: Skin) -> None:
    own = maps.joint == PIP
    back, front = own & (maps.wrinkles < -0.05), own & (maps.folds < -0.05)
    assert min(back.sum(), front.sum()) > 20
    wrinkles = [relief(maps, skin, d, own & (maps.folds > -0.01)) for d in (-10, 0, 40, 90)]
    folds = [relief(maps, skin, d, front) for d in (0, 40, 90)]
    assert np.all(np.diff(wrinkles) < 0)
    assert wrinkles[-1] < 0.3 * wrinkles[1]
    assert np.all(np.diff(folds) > 0)


def test_properties_one_joint_moves_its_own_creases_alone(maps: SkinMaps, skin: Skin) -> None:
    bent = np.zeros(16)
    bent[PIP] = 1.0
    moved = np.abs(height_m(maps, skin, bent) - height_m(maps, skin, np.zeros(16)))[..., 0] > 1e-7
    assert moved.any()
    assert not moved[(maps.joint != PIP)[maps.fill]].any()


def test_properties_nails_shine_and_varnish_more(maps: SkinMaps, skin: Skin) -> None:
    plate = (maps.plate > 0.98)[maps.fill]
    rough, coat = gloss(maps, skin)
    assert rough[plate].mean() < rough[~plate].mean() - 0.08
    assert coat[plate].mean() > 0.2
    painted, more = gloss(maps, replace(skin, varnish_rgb=(0.4, 0.0, 0.0)))
    assert painted[plate].mean() < rough[plate].mean()
    assert more[plate].mean() > coat[plate].mean()


def test_edge_no_creases(maps: SkinMaps, skin: Skin) -> None:
    flat = height_m(maps, replace(skin, creases=0.0), np.full(16, 0.5))
    np.testing.assert_allclose(flat[..., 0], 1e-3 * maps.still[maps.fill], atol=1e-9)
