"""Keypoint sets of hands and bodies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import body_files
import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.models import KEYPOINTS73_NAMES, keypoints73, load, load_hand, openpose21
from synthgen.models import joints as tables
from synthgen.models.keypoints import hand_points
from synthgen.sampling.streams import stream


@pytest.fixture
def body(tmp_path: Path):
    np.savez(tmp_path / "body.npz", **body_files.body("smplh"), landmark_ids=np.arange(11),
             fingertip_ids=np.arange(20, 30))  # fmt: skip
    return load(tmp_path / "body.npz")


def test_reference_tables() -> None:
    """Parents come before children, on the right bones, as in the published trees."""
    assert tables.SMPLH52_PARENTS[:25] == (
        -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 22, 23,
    )  # fmt: skip
    assert tables.SMPLH52_PARENTS[37:41] == (21, 37, 38, 21)
    assert tables.SUPR75_NAMES[22:26] == ("jaw", "left_eye", "right_eye", "left_index1")
    assert tables.SUPR75_PARENTS[22:26] == (15, 15, 15, 20)
    assert tables.SUPR75_PARENTS[55:59] == (10, 55, 10, 57)
    assert tables.SUPR75_PARENTS[65:67] == (11, 65)
    assert tables.STAR24_PARENTS[22:] == (20, 21)
    assert len(tables.SUPR75_NAMES) == len(set(tables.SUPR75_NAMES)) == 75
    assert len(KEYPOINTS73_NAMES) == len(set(KEYPOINTS73_NAMES)) == 73
    for v in (6890, 10475):
        assert len(tables.LANDMARKS[v]) == len(tables.LANDMARK_NAMES)
        assert len(tables.BODY_TIPS[v]) == 10


def test_reference_73(body) -> None:
    pose = stream(0, "sample", 0, 0, "keypoints").normal(0, 0.3, (2, 52, 3))
    posed = body.evaluate(np.zeros((2, 1)), pose)
    points = keypoints73(body, posed)
    np.testing.assert_array_equal(points[:, :52], posed.joints)
    np.testing.assert_array_equal(points[:, 52:63], posed.vertices[:, :11])
    np.testing.assert_array_equal(points[:, 63:], posed.vertices[:, 20:30])
    assert KEYPOINTS73_NAMES[62:64] == ("right_heel", "left_thumb_tip")


def test_reference_73_of_supr_are_found_by_name(tmp_path: Path) -> None:
    content = body_files.body("supr")
    ids = {"landmark_ids": np.arange(11), "fingertip_ids": np.arange(20, 30)}
    model = load(body_files.write_supr(tmp_path / "supr.npy", content | ids))
    posed = model.evaluate(np.zeros((1, 1)), np.zeros((1, 75, 3)))
    points = keypoints73(model, posed)
    at = KEYPOINTS73_NAMES.index("left_index1")
    assert at == 22
    np.testing.assert_array_equal(points[0, at], posed.joints[0, 25])


def test_reference_openpose_of_both_hands(body) -> None:
    pose = stream(1, "sample", 0, 0, "keypoints").normal(0, 0.3, (1, 52, 3))
    posed = body.evaluate(np.zeros((1, 1)), pose)
    for side, first, wrist in (("left", 20, 20), ("right", 25, 21)):
        points = openpose21(body, posed, side)[0]
        np.testing.assert_array_equal(points[0], posed.joints[0, wrist])
        thumb = body.joint_names.index(f"{side}_thumb1")
        np.testing.assert_array_equal(points[1:4], posed.joints[0, thumb : thumb + 3])
        np.testing.assert_array_equal(points[4], posed.vertices[0, first])
        index = body.joint_names.index(f"{side}_index1")
        np.testing.assert_array_equal(points[5:8], posed.joints[0, index : index + 3])
        np.testing.assert_array_equal(points[20], posed.vertices[0, first + 4])


def test_properties_tips_are_where_the_fingers_end() -> None:
    hand = load_hand("cc0-hand")
    joints, tips = hand_points(hand)
    rest = hand.v_template
    for k, joint in enumerate(joints[[15, 3, 6, 12, 9]]):
        own = hand.weights.argmax(axis=1) == joint
        bone = hand.J_regressor @ rest
        reach = np.linalg.norm(rest[own] - bone[joint], axis=1)
        assert np.linalg.norm(rest[tips[k]] - bone[joint]) > 0.8 * reach.max()


def test_edge_what_is_lacking(body, tmp_path: Path) -> None:
    posed = body.evaluate(np.zeros((1, 1)), np.zeros((1, 52, 3)))
    with pytest.raises(ModelError, match="hand='left'"):
        openpose21(body, posed)
    with pytest.raises(ModelError, match="landmarks"):
        keypoints73(replace(body, landmark_ids=np.zeros(0, int)), posed)
    hand = load_hand("cc0-hand")
    with pytest.raises(ModelError, match="52 joints"):
        keypoints73(hand, posed)
    with pytest.raises(ModelError, match="no fingers of a left hand"):
        openpose21(hand, posed, "left")
    np.savez(tmp_path / "bad.npz", **body_files.body("smplh"), landmark_ids=np.full(11, 999))
    with pytest.raises(ModelError, match="not 11 of 128"):
        load(tmp_path / "bad.npz")
