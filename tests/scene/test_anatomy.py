"""Landmarks of hands: shared by left and right, found in bare files too, angles that bend."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from synthgen.models import ManoModel, load, mirror_pose
from synthgen.sampling.limits import limits_of
from synthgen.scene.anatomy import anatomy_of, flexion_rad


@pytest.fixture(scope="module")
def hand() -> ManoModel:
    return load("cc0-hand")


def bare(hand: ManoModel, path: Path) -> ManoModel:
    """Write the hand as MANO files are published, without arm, atlas and masks, and load it."""
    table = np.stack([np.where(hand.parents < 0, 4294967295, hand.parents), np.arange(16)])
    np.savez(
        path, v_template=hand.v_template, shapedirs=hand.shapedirs, posedirs=hand.posedirs,
        weights=hand.weights, J_regressor=hand.J_regressor, kintree_table=table, f=hand.faces,
        hands_mean=hand.hands_mean, hands_components=hand.hands_components,
    )  # fmt: skip
    return load(path)


def test_smoke_five_fingers_with_nails(hand: ManoModel) -> None:
    anatomy = anatomy_of(hand)
    assert [f.name for f in anatomy.fingers] == ["index", "middle", "pinky", "ring", "thumb"]
    assert all(f.nail is not None for f in anatomy.fingers)
    assert len(anatomy.points) == len(anatomy.normals) == len(anatomy.weights)
    np.testing.assert_allclose(anatomy.weights.sum(axis=1), 1, atol=1e-6)


def test_reference_nails_have_the_size_of_nails(hand: ManoModel) -> None:
    for finger in anatomy_of(hand).fingers:
        nail = finger.nail
        assert nail is not None
        assert 0.0035 < nail.half_length < 0.0095
        assert 0.0035 < nail.half_width < 0.0085
        assert nail.out @ finger.back > 0.8
        assert (nail.centre - finger.points[2]) @ nail.along > 0.005


def test_properties_left_is_the_right_hand_mirrored(hand: ManoModel) -> None:
    left, right = anatomy_of(load("cc0-hand", hand="left")), anatomy_of(hand)
    np.testing.assert_allclose(left.points, right.points, atol=1e-9)
    np.testing.assert_allclose(left.normals, right.normals, atol=1e-9)


def test_properties_normals_point_out(hand: ManoModel) -> None:
    anatomy = anatomy_of(hand)
    back = (anatomy.weights[:, 0] > 0.9) & (anatomy.points[:, 0] < -0.03)
    middle = np.median(anatomy.points[back, 1])
    assert anatomy.normals[back & (anatomy.points[:, 1] > middle), 1].mean() > 0.5


@pytest.mark.parametrize("side", ["right", "left"])
def test_reference_flexion_is_the_angle_about_the_joints_axis(side: str) -> None:
    model = load("cc0-hand", hand=side)
    angles = np.linspace(-0.3, 1.2, 16)
    axes = limits_of(load("cc0-hand")).axes[:, 0]
    pose = angles[:, None] * axes
    pose[0] = 0
    if side == "left":
        pose = mirror_pose(pose)
    found = flexion_rad(model, pose)
    np.testing.assert_allclose(found[1:], angles[1:], atol=0.05)
    assert found[0] == 0


def test_edge_a_bare_file_has_the_same_landmarks(hand: ManoModel, tmp_path: Path) -> None:
    own, found = anatomy_of(hand), anatomy_of(bare(hand, tmp_path / "bare.npz"))
    for a, b in zip(own.fingers, found.fingers, strict=True):
        assert a.nail is not None
        assert b.nail is not None
        np.testing.assert_allclose(a.nail.centre, b.nail.centre, atol=1.5e-3)
        assert a.nail.half_width == pytest.approx(b.nail.half_width, rel=0.2)
