"""Relief beyond the model: bounded, switchable, following the pose, the same on both hands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.models import ManoModel, load, mirror_pose
from synthgen.sampling.appearance import sample_skin
from synthgen.sampling.limits import limits_of
from synthgen.sampling.streams import stream
from synthgen.scene import Skin
from synthgen.scene.anatomy import anatomy_of
from synthgen.scene.relief import relief_of
from synthgen.scene.surface import DrawnSurface

BOUND_M = 0.002
FLAT = np.zeros((16, 3))


@pytest.fixture(scope="module")
def hand() -> ManoModel:
    return load("cc0-hand")


@pytest.fixture(scope="module")
def skin() -> Skin:
    drawn, _ = sample_skin((0.3, 0.3), rng=stream(0, "subject", 0, 0, "skin"))
    return replace(drawn, relief_m=BOUND_M)


def bent(hand: ManoModel, degrees: float) -> np.ndarray:
    pose = FLAT.copy()
    for joint in (1, 4, 7, 10):
        pose[joint] = np.deg2rad(degrees) * limits_of(hand).axes[joint, 0]
    return pose


def heights(hand: ManoModel, skin: Skin, pose: np.ndarray) -> np.ndarray:
    found = relief_of(hand, skin, pose)
    assert found is not None
    return found


def test_smoke_shape(hand: ManoModel, skin: Skin) -> None:
    assert heights(hand, skin, FLAT).shape == (len(anatomy_of(hand).points),)


def test_edge_zero_draws_the_models_surface(hand: ManoModel, skin: Skin) -> None:
    assert relief_of(hand, replace(skin, relief_m=0.0), FLAT) is None


@pytest.mark.parametrize("bound", [0.0005, 0.002, 0.004])
def test_properties_never_beyond_the_recorded_bound(
    hand: ManoModel, skin: Skin, bound: float
) -> None:
    for degrees in (-25, 0, 80):
        height = heights(hand, replace(skin, relief_m=bound, veins=3.0), bent(hand, degrees))
        assert np.abs(height).max() < bound
        assert height.max() > 0.3 * bound


def test_properties_drawn_vertices_stay_within_the_bound(hand: ManoModel, skin: Skin) -> None:
    drawn = DrawnSurface.for_model(hand)
    rest = np.concatenate([hand.v_template, hand.surface.arm.template])
    moved = drawn.refine(rest, heights(hand, skin, FLAT)) - drawn.refine(rest)
    np.testing.assert_array_less(np.linalg.norm(moved, axis=1), BOUND_M)


def test_properties_tendons_stand_out_in_extension(hand: ManoModel, skin: Skin) -> None:
    a = anatomy_of(hand)
    middle = a.fingers[1].points[0]
    on_cord = (
        (np.abs(a.points[:, 0] - 0.7 * middle[0]) < 0.01)
        & (np.abs(a.points[:, 2] - 0.8 * middle[2]) < 0.0025)
        & (a.normals[:, 1] > 0.7)
    )
    assert on_cord.sum() > 5
    levels = [heights(hand, skin, bent(hand, d))[on_cord].max() for d in (-25, 0, 80)]
    assert levels[0] > levels[1] > levels[2]
    assert levels[0] - levels[2] > 3e-4


def test_properties_knuckles_stand_out_in_a_fist(hand: ManoModel, skin: Skin) -> None:
    a = anatomy_of(hand)
    top = a.fingers[1].points[0] + [0, 0.009, 0]
    near = np.linalg.norm(a.points - top, axis=1) < 0.006
    assert (
        heights(hand, skin, bent(hand, 80))[near].mean()
        > heights(hand, skin, bent(hand, 20))[near].mean() + 1e-4
    )


def test_properties_left_equals_right(hand: ManoModel, skin: Skin) -> None:
    pose = bent(hand, 30)
    left = heights(load("cc0-hand", hand="left"), skin, mirror_pose(pose))
    np.testing.assert_allclose(left, heights(hand, skin, pose), atol=1e-7)


def test_properties_veins_follow_their_gain(hand: ManoModel, skin: Skin) -> None:
    none, some = (heights(hand, replace(skin, veins=gain), FLAT) for gain in (0.0, 1.0))
    assert (some - none).max() > 1e-4
    assert (some - none).min() > -1e-9
