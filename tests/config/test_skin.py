"""Switches of the skin: documented, bounded, and each changes its own ingredient alone."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from synthgen.config import load_config
from synthgen.config.skin import SkinSettings
from synthgen.errors import ConfigError
from synthgen.sampling.draw import draw_sample
from synthgen.scene import Skin


def skin(*overrides: str) -> Skin:
    return draw_sample(load_config("fixtures", list(overrides)), 0).scene.subjects[0].skin


def test_smoke_plain_leaves_detail_off_and_full_turns_it_on() -> None:
    plain, full = load_config("hand_rgbd").skin, load_config("hand_full").skin
    assert (plain.detail, plain.relief_m, plain.varnish) == (False, 0.0, 0.0)
    assert (full.detail, full.relief_m) == (True, 0.002)


def test_properties_every_field_is_documented() -> None:
    for name, field in SkinSettings.model_fields.items():
        assert field.description, name


@pytest.mark.parametrize("name", ["creases", "veins", "mottle", "freckles", "sweat"])
def test_properties_a_gain_changes_its_ingredient_alone(name: str) -> None:
    usual, without = asdict(skin()), asdict(skin(f"skin.{name}=0"))
    assert without[name] == 0 != usual[name]
    assert {k for k in usual if usual[k] != without[k]} == {name}


def test_properties_varnish_changes_nothing_else() -> None:
    usual, painted = asdict(skin()), asdict(skin("skin.varnish=1"))
    assert usual["varnish_rgb"] is None
    assert painted["varnish_rgb"] is not None
    assert {k for k in usual if usual[k] != painted[k]} == {"varnish_rgb"}


def test_properties_switches_leave_hand_pose_and_camera(name: str = "skin.detail=true") -> None:
    usual = draw_sample(load_config("fixtures"), 1)
    changed = draw_sample(load_config("fixtures", [name, "skin.relief_m=0.002"]), 1)
    assert usual.scene.cameras == changed.scene.cameras
    assert usual.scene.lights == changed.scene.lights
    assert usual.scene.subjects[0].pose == changed.scene.subjects[0].pose


@pytest.mark.parametrize("bad", ["skin.relief_m=0.01", "skin.creases=-1", "skin.detail=3"])
def test_edge_out_of_range(bad: str) -> None:
    with pytest.raises(ConfigError, match=r"skin\."):
        load_config("fixtures", [bad])
