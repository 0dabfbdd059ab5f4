"""Constrained trees: the published code's signs, the consistent reading, and bad tables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import body_files
import numpy as np
import pytest
from random_models import draw, model

from synthgen.errors import ModelError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import ConstrainedTree
from synthgen.models.pose_features import (
    hamilton,
    quaternion_feature,
    rotations_and_features,
)

IDENTITY = np.array([0.0, 0, 0, 1])


def meta(**change: Any) -> dict[str, Any]:
    """Joint 0 spherical, joint 1 a double hinge, joint 2 a hinge, joint 3 spherical."""
    return {
        "num_pose": 9, "indx_spherical": [[0, 1, 2], [6, 7, 8]], "indx_hinge": [[5]],
        "indx_double_hinge1": [3], "indx_double_hinge2": [4], "indx_hinge_axis": [2],
        "indx_double_hinge1_axis": [0], "indx_double_hinge2_axis": [1],
        "reverse_indx": [0, 3, 2, 1], "axis_indx": [0, 1, 2],
        "axis": np.array([[[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]]),
    } | change  # fmt: skip


def small(constrained: str = "official", **change: Any) -> Any:
    made = model("official")
    tree = ConstrainedTree.from_meta(meta(**change), 4)
    return replace(made, axis_meta=tree, constrained=constrained, parents=np.array([-1, 0, 1, 2]))


def test_reference_hinge_turns_against_its_angle() -> None:
    """R(axis, -angle), while the correctives of the published code see +angle."""
    pose = np.zeros((1, 9))
    pose[0, 5] = 0.7
    axis = np.array([0, 0, 1.0])
    for mode, sign in (("official", 1), ("consistent", -1)):
        rotations, features = rotations_and_features(small(mode), pose)
        np.testing.assert_allclose(rotations[0, 2], matrix_from_axis_angle(-0.7 * axis), atol=1e-15)
        np.testing.assert_allclose(
            features[0, 2], quaternion_feature(sign * 0.7 * axis), atol=1e-15
        )


def test_reference_double_hinge() -> None:
    pose = np.zeros((1, 9))
    pose[0, 3:5] = 0.4, -0.9
    first, second = np.array([0.4, 0, 0]), np.array([0, -0.9, 0])
    want = matrix_from_axis_angle(-first) @ matrix_from_axis_angle(-second)
    rotations, official = rotations_and_features(small(), pose)
    np.testing.assert_allclose(rotations[0, 1], want, atol=1e-15)
    product = hamilton(quaternion_feature(first), quaternion_feature(second))
    np.testing.assert_allclose(official[0, 1], product, atol=1e-15)
    rotations, consistent = rotations_and_features(small("consistent"), pose)
    np.testing.assert_allclose(rotations[0, 1], want, atol=1e-15)
    whole = hamilton(*(quaternion_feature(-r) + IDENTITY for r in (first, second)))
    np.testing.assert_allclose(consistent[0, 1], whole - IDENTITY, atol=1e-15)


@pytest.mark.parametrize("column", [3, 4])
def test_reference_official_double_hinge_corrects_nothing_with_one_angle(column: int) -> None:
    """The identity is taken off both factors: the product vanishes if one angle is zero."""
    pose = np.zeros((1, 9))
    pose[0, column] = 0.8
    assert not rotations_and_features(small(), pose)[1][0, 1].any()
    assert np.abs(rotations_and_features(small("consistent"), pose)[1][0, 1]).max() > 0.3


def test_properties_consistent_equals_the_unconstrained_model() -> None:
    """The same rotations given as matrices to a free tree: same mesh, correctives included."""
    made = model("consistent")
    given = draw(made, 4, spread=0.8)
    rotations, _ = rotations_and_features(made, given.pose)
    free = replace(made, axis_meta=None)
    a, b = made.evaluate_reference(*given), free.evaluate_reference(
        given.shape, rotations, given.translation)  # fmt: skip
    np.testing.assert_allclose(a[0], b[0], atol=1e-12)
    official, _ = replace(made, constrained="official").evaluate_reference(*given)
    assert np.abs(official - a[0]).max() > 1e-4


def test_properties_a_constrained_model_takes_free_poses_too() -> None:
    made = model("official")
    pose = draw(replace(made, axis_meta=None), 2).pose
    free = replace(made, axis_meta=None).evaluate(np.zeros((2, 6)), pose)
    np.testing.assert_array_equal(made.evaluate(np.zeros((2, 6)), pose).vertices, free.vertices)


def test_properties_table_there_and_back() -> None:
    tree = ConstrainedTree.from_meta(body_files.axis_meta(75, 20, 8), 75)
    again = ConstrainedTree.from_meta(tree.to_meta(), 75)
    for name in tree.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(tree, name))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"num_pose": 8}, "num_pose is 8"),
        ({"num_pose": 2**62}, "num_pose is 4611686018427387904"),
        ({"indx_hinge": [[6]]}, "8 of them different"),
        ({"indx_hinge_axis": [3]}, "indx_hinge_axis refers to 3 of 3"),
        ({"indx_hinge_axis": []}, "numbers of hinges and of their axes"),
        ({"indx_double_hinge2": []}, "1 first and 0 second"),
        ({"reverse_indx": [0, 3, 2, 2]}, "order all 4 joints once"),
        ({"indx_hinge": [[0.5]]}, "whole numbers"),
        ({"indx_spherical": [[0, 1], [6, 7]]}, "threes"),
        ({"axis": np.full((1, 3, 3), np.nan)}, "finite"),
        ({"axis": np.zeros((1, 3, 2))}, "axis is"),
        ({"num_pose": []}, "num_pose"),
    ],
)
def test_edge_bad_tables(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ModelError, match=words):
        ConstrainedTree.from_meta(meta(**change), 4)


def test_edge_missing_key() -> None:
    content = meta()
    del content["axis"]
    with pytest.raises(ModelError, match="no axis;"):
        ConstrainedTree.from_meta(content, 4)


def test_edge_unknown_mode() -> None:
    made = small("physical")
    with pytest.raises(ModelError, match=r"'official'.*'consistent'"):
        rotations_and_features(made, np.zeros((1, 9)))
