"""Body poses: the A-pose, spreads, ranges, hands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.errors import ModelError, SamplingError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import BodyModel, load
from synthgen.models.hand_pca import finger_joints
from synthgen.sampling.body_contact import limbs_inside
from synthgen.sampling.body_limits import body_range, swing_twist
from synthgen.sampling.body_pose import (
    INSIDE_SHARE,
    a_pose,
    fold,
    sample_body_pose,
    sample_fingers,
    upright,
)
from synthgen.sampling.streams import stream


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load("cc0-body")


def test_smoke_hands_hang_beside_the_hips_in_an_a_pose(body: BodyModel) -> None:
    pose = a_pose(body)
    joints = body.evaluate_joints(np.zeros((1, 16)), pose[None])[0]
    wrists = joints[[body.joint_names.index(f"{s}_wrist") for s in ("left", "right")]]
    shoulder = joints[body.joint_names.index("left_shoulder")]
    assert 0.25 < shoulder[1] - wrists[0, 1] < 0.5
    np.testing.assert_allclose(wrists[0] * [-1, 1, 1], wrists[1], atol=1e-4)
    np.testing.assert_allclose(pose[finger_joints(body, "left")].ravel(), body.hands_left.mean)
    pose[:] = 9
    assert not np.any(a_pose(body) == 9)


def test_shape_without_spread_only_the_fingers_differ(body: BodyModel) -> None:
    pose = sample_body_pose(body, 0.0, rng=stream(0, "sample", 0, 0, "pose"))
    others = np.setdiff1d(
        np.arange(52), [*finger_joints(body, "left"), *finger_joints(body, "right")]
    )
    np.testing.assert_allclose(pose[others], a_pose(body)[others], atol=1e-12)
    assert np.abs(pose - a_pose(body)).max() > 0.05


@pytest.mark.parametrize("name", ["cc0-body", "cc0-supr"])
def test_properties_ranges_and_clear_limbs(name: str) -> None:
    model = load(name)
    rng = stream(1, "sample", 0, 0, "pose")
    low, high = np.moveaxis(body_range(model.joint_names), -1, 0)
    knee, elbow = (model.joint_names.index(f"right_{j}") for j in ("knee", "elbow"))
    bent = []
    for _ in range(4):
        pose = sample_body_pose(model, 1.0, rng=rng)
        assert pose.shape == (len(model.joint_names), 3)
        assert np.all(pose[0] == 0)
        assert limbs_inside(model, np.zeros(model.n_shape), pose) <= INSIDE_SHARE
        assert pose[knee, 0] >= 0
        bent.append(pose[elbow, 1])
    assert min(bent) >= -0.1
    assert np.ptp(bent) > 0.05
    assert np.all(low <= high)


def test_properties_the_same_rng_gives_the_same_pose(body: BodyModel) -> None:
    first, second = (sample_body_pose(body, rng=stream(2, "sample", 0, 0, "p")) for _ in range(2))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, sample_body_pose(body, rng=stream(3, "sample", 0, 0, "p")))


def test_properties_hands_stay_inside_the_table(body: BodyModel) -> None:
    space = body.hands_right
    assert space is not None
    assert space.coeffs is not None
    rng = stream(4, "sample", 0, 0, "hands")
    table = space.mean + space.coeffs @ space.components
    hands = np.array([sample_fingers(body, "right", rng=rng).ravel() for _ in range(100)])
    beyond = np.maximum(hands - table.max(axis=0), table.min(axis=0) - hands)
    assert beyond.max() < np.deg2rad(10)
    mirrored = np.array([sample_fingers(body, "left", rng=rng).ravel() for _ in range(300)])
    flip = np.tile([1.0, -1.0, -1.0], 15)
    np.testing.assert_allclose(mirrored.mean(axis=0) * flip, hands.mean(axis=0), atol=0.15)


def test_reference_fold() -> None:
    low, high = np.array([0.0, -1.0, 2.0]), np.array([1.0, 1.0, 2.0])
    np.testing.assert_allclose(fold(np.array([-0.25, 1.5, 7.0]), low, high), [0.25, 0.5, 2.0])
    np.testing.assert_allclose(fold(np.array([1.75, 0.3, 2.0]), low, high), [0.25, 0.3, 2.0])


def test_reference_swing_after_twist() -> None:
    """An elbow twists about its forearm (x) first, then swings."""
    angles = np.array([[0.3, 0.5, 0.0]])
    found = matrix_from_axis_angle(swing_twist(["left_elbow"], angles))[0]
    swing, twist = matrix_from_axis_angle(np.array([[0, 0.5, 0], [0.3, 0, 0]]))
    np.testing.assert_allclose(found, swing @ twist, atol=1e-12)


def test_properties_upright() -> None:
    rng = stream(5, "sample", 0, 0, "root")
    turns = matrix_from_axis_angle(np.array([upright(rng=rng) for _ in range(300)]))
    lean = np.rad2deg(np.arccos(turns[:, 1, 1]))
    assert 1 < np.median(lean) < 6
    assert lean.max() < 20
    heading = np.arctan2(turns[:, 0, 2], turns[:, 2, 2])
    assert np.abs(np.exp(1j * heading).mean()) < 0.15


def test_properties_an_arm_in_the_belly_is_seen(body: BodyModel) -> None:
    pose = a_pose(body)
    assert limbs_inside(body, np.zeros(16), pose) == 0
    pose[body.joint_names.index("right_shoulder"), 2] = 2.0
    assert limbs_inside(body, np.zeros(16), pose) > 0.05


def test_edge_errors(body: BodyModel) -> None:
    rng = stream(6, "sample", 0, 0, "x")
    with pytest.raises(SamplingError, match="spread=3"):
        sample_body_pose(body, 3, rng=rng)
    with pytest.raises(ModelError, match="left_knee"):
        a_pose(load("cc0-hand"))


def test_edge_a_model_without_a_pose_table(body: BodyModel) -> None:
    bare = replace(body, hands_left=None, hands_right=None, name="bare")
    pose = sample_body_pose(bare, 0.3, rng=stream(7, "sample", 0, 0, "x"))
    left, right = (pose[finger_joints(bare, s)][:12, 2] for s in ("left", "right"))
    assert left.mean() < 0 < right.mean()
