"""Creases: wrinkles behind joints, folds before them, lines in the palm."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.models import load
from synthgen.render.skin.creases import Creases, lay_creases
from synthgen.render.skin.sites import Sites, atlas_sites
from synthgen.scene.anatomy import anatomy_of


@pytest.fixture(scope="module")
def laid() -> tuple[Sites, Creases]:
    model = load("cc0-hand")
    sites, _ = atlas_sites(model, 512)
    return sites, lay_creases(sites, anatomy_of(model))


def test_smoke_shapes(laid: tuple[Sites, Creases]) -> None:
    sites, creases = laid
    for values in (creases.wrinkles, creases.folds, creases.lines, creases.tint, creases.joint):
        assert values.shape == (len(sites.points),)
    assert 0 <= creases.tint.min() <= creases.tint.max() <= 1


def test_reference_depths_are_those_of_skin(laid: tuple[Sites, Creases]) -> None:
    """Tenths of a millimetre."""
    _, creases = laid
    for values, least, most in (
        (creases.wrinkles, 0.15, 0.9), (creases.folds, 0.2, 0.8), (creases.lines, 0.2, 0.9),
    ):  # fmt: skip
        assert least < -values.min() < most


def test_properties_backs_wrinkle_and_palms_fold(laid: tuple[Sites, Creases]) -> None:
    sites, creases = laid
    fingers = anatomy_of(load("cc0-hand")).fingers[:4]
    for number, finger in enumerate(fingers):
        own = sites.finger_weight(number) > 0.9
        facing = sites.normals @ finger.back
        assert facing[own & (creases.wrinkles < -0.1)].mean() > 0.3
        assert facing[own & (creases.folds < -0.1)].mean() < -0.3


def test_properties_each_crease_belongs_to_its_joint(laid: tuple[Sites, Creases]) -> None:
    sites, creases = laid
    for finger in anatomy_of(load("cc0-hand")).fingers[:4]:
        for joint, place in zip(finger.joints[1:], finger.points[1:], strict=False):
            own = (creases.joint == joint) & (creases.wrinkles < -0.06)
            assert own.sum() > 10
            away = np.linalg.norm(sites.points[own] - place, axis=1)
            assert np.quantile(away, 0.95) < 0.022


def test_properties_three_lines_cross_the_palm(laid: tuple[Sites, Creases]) -> None:
    sites, creases = laid
    marked = (creases.lines < -0.15) & (sites.weights[:, 0] > 0.5)
    assert sites.normals[marked, 1].mean() < -0.5
    # Walking from wrist to fingers under the middle finger meets at least two of them.
    strip = (np.abs(sites.points[:, 2]) < 0.004) & (sites.normals[:, 1] < -0.5)
    bins = np.round(sites.points[strip & marked, 0] / 0.004)
    assert len(np.unique(bins)) >= 2


def test_properties_nothing_on_the_forearm(laid: tuple[Sites, Creases]) -> None:
    sites, creases = laid
    arm = sites.points[:, 0] > 0.04
    assert np.abs(creases.wrinkles[arm]).max() == 0
    assert np.abs(creases.lines[arm]).max() < 1e-6
