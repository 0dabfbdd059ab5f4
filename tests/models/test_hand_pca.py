"""PCA coefficients to full poses: the mean is added when asked for, and only then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import model

from synthgen.errors import ModelError, ShapeError
from synthgen.models import load_hand, pose_from_pca
from synthgen.models.hand_pca import finger_joints
from synthgen.sampling.streams import stream


def test_reference_mano() -> None:
    made = model("mano")
    c = stream(0, "sample", 0, 0, "pca").normal(size=(2, 6))
    root = np.full((2, 1, 3), 0.3)
    assert made.hands_mean is not None
    assert made.hands_components is not None
    for flat in (True, False):
        pose = pose_from_pca(made, root, c, flat_hand_mean=flat)
        want = c @ made.hands_components[:6] + (0 if flat else made.hands_mean)
        np.testing.assert_allclose(pose[:, 1:].reshape(2, 45), want, atol=1e-15)
        np.testing.assert_array_equal(pose[:, 0], root[:, 0])


def test_reference_smplh_has_78_numbers() -> None:
    """66 of the body's 22 joints, then six components a hand."""
    made = model("smplh")
    vector = stream(0, "sample", 0, 0, "pca").normal(0, 0.3, (3, 78))
    assert made.hands_left is not None
    assert made.hands_right is not None
    pose = np.zeros((3, 52, 3))
    pose[:, :22] = vector[:, :66].reshape(3, 22, 3)
    left = vector[:, 66:72] @ made.hands_left.components[:6] + made.hands_left.mean
    right = vector[:, 72:] @ made.hands_right.components[:6] + made.hands_right.mean
    pose[:, 22:37], pose[:, 37:] = left.reshape(3, 15, 3), right.reshape(3, 15, 3)
    shape = np.ones((3, 6))
    a, b = made.evaluate(shape, vector, flat_hand_mean=False), made.evaluate(shape, pose)
    np.testing.assert_array_equal(a.vertices, b.vertices)
    joints = made.evaluate_joints(shape, vector, flat_hand_mean=False)
    np.testing.assert_array_equal(joints, b.joints)


def test_properties_all_45_components_are_pca_too() -> None:
    """Published layers take 45 coefficients for plain axis-angle; here they stay coefficients."""
    hand = load_hand("cc0-hand")
    vector = np.zeros((1, 48))
    vector[0, 3] = 1.0
    pose = hand.evaluate(np.zeros((1, 10)), vector, flat_hand_mean=True)
    raw = hand.evaluate(np.zeros((1, 10)), vector.reshape(1, 16, 3))
    assert np.abs(pose.vertices - raw.vertices).max() > 1e-3


def test_properties_fingers_are_found_by_name() -> None:
    made = model("supr")
    np.testing.assert_array_equal(finger_joints(made, "left"), np.arange(25, 40))
    np.testing.assert_array_equal(finger_joints(made, "right"), np.arange(40, 55))
    np.testing.assert_array_equal(finger_joints(model("mano"), "right"), np.arange(1, 16))


@pytest.mark.parametrize(
    ("vector", "words"),
    [
        (np.zeros((1, 77)), r"66 \+ 2 n"),
        (np.zeros((1, 60)), r"66 \+ 2 n"),
        (np.zeros((1, 52, 3)), r"66 \+ 2 n"),
        (np.zeros((1, 66 + 92)), "n <= 45"),
    ],
)
def test_edge_bad_vectors(vector: np.ndarray, words: str) -> None:
    with pytest.raises(ShapeError, match=words):
        model("smplh").evaluate(np.zeros((1, 6)), vector, flat_hand_mean=True)


def test_edge_models_without_a_pose_space() -> None:
    bare = replace(model("smplh"), hands_left=None)
    with pytest.raises(ModelError, match="no pose space of the left hand"):
        bare.evaluate(np.zeros((1, 6)), np.zeros((1, 78)), flat_hand_mean=True)
    with pytest.raises(ModelError, match="no fingers of a left hand"):
        finger_joints(model("star"), "left")
    with pytest.raises(ModelError, match="no fingers of a left hand"):
        finger_joints(model("mano"), "left")


def test_edge_wrong_number_of_hands() -> None:
    with pytest.raises(ShapeError, match="2 hands"):
        pose_from_pca(model("smplh"), np.zeros((1, 22, 3)), np.zeros((1, 6)), flat_hand_mean=True)
    with pytest.raises(ShapeError, match=r"\(B, 22, 3\)"):
        pose_from_pca(
            model("smplh"), np.zeros((1, 21, 3)), *np.zeros((2, 1, 6)), flat_hand_mean=True
        )
