"""Evaluation against the float64 reference, and the invariants of linear blend skinning."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from synthgen.models import ManoModel, load
from synthgen.sampling.streams import stream


@pytest.fixture(scope="module", params=["right", "left"])
def hand(request: pytest.FixtureRequest) -> ManoModel:
    return load("cc0-hand", hand=request.param)


def draws(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = stream(0, "sample", 0, 0, "mano")
    return rng.normal(size=(n, 10)), rng.normal(0, 0.5, (n, 16, 3)), rng.normal(size=(n, 3))


def test_reference_float64(hand: ManoModel) -> None:
    posed = hand.evaluate(*draws(6))
    vertices, joints = hand.evaluate_reference(*draws(6))
    np.testing.assert_allclose(posed.vertices, vertices, atol=1e-6)
    np.testing.assert_allclose(posed.joints, joints, atol=1e-6)


def test_properties_batch_equals_loop(hand: ManoModel) -> None:
    shape, pose, move = draws(5)
    together = hand.evaluate(shape, pose, move).vertices
    alone = [hand.evaluate(shape[k, None], pose[k, None], move[k, None]).vertices[0]
             for k in range(5)]  # fmt: skip
    np.testing.assert_allclose(together, alone, atol=2e-7)


def test_properties_zero_pose_is_the_shaped_template(hand: ManoModel) -> None:
    shape = draws(1)[0]
    posed = hand.evaluate(shape, np.zeros((1, 16, 3)))
    np.testing.assert_allclose(posed.vertices[0], hand.shaped(shape[0])[0], atol=1e-7)


def test_properties_root_turns_about_joint_zero(hand: ManoModel) -> None:
    shape, pose, move = draws(1)
    turn = matrix_from_axis_angle(np.array([0.3, -1.0, 0.7]))
    turned = pose.copy()
    turned[0, 0] = axis_angle_from_matrix(turn @ matrix_from_axis_angle(pose[0, 0]))
    a, b = hand.evaluate(shape, pose, move), hand.evaluate(shape, turned, move)
    pivot = a.joints[0, 0].astype(float)
    np.testing.assert_allclose(b.vertices[0], (a.vertices[0] - pivot) @ turn.T + pivot, atol=2e-6)


def test_properties_mean_pose_is_included(hand: ManoModel) -> None:
    """Full axis-angle in, nothing added: a zero pose is flat, not the mean pose."""
    mean = np.concatenate([np.zeros(3), hand.hands_mean]).reshape(1, 16, 3)
    flat, relaxed = (
        hand.evaluate(np.zeros((1, 10)), np.zeros((1, 16, 3))),
        hand.evaluate(np.zeros((1, 10)), mean),
    )
    assert np.abs(flat.vertices - relaxed.vertices).max() > 0.01


@pytest.mark.parametrize(
    ("shape", "pose", "words"),
    [
        (np.zeros((1, 11)), np.zeros((1, 16, 3)), "nb <= 10"),
        (np.zeros((1, 10)), np.zeros((1, 48)), "axis-angle"),
        (np.full((1, 10), np.nan), np.zeros((1, 16, 3)), "finite"),
        (np.zeros((2, 10)), np.zeros((1, 16, 3)), r"expected \(1"),
    ],
)
def test_edge_bad_arguments(shape: np.ndarray, pose: np.ndarray, words: str) -> None:
    with pytest.raises(ShapeError, match=words):
        load("cc0-hand").evaluate(shape, pose)


def test_edge_expression_is_refused() -> None:
    with pytest.raises(ShapeError, match="expression"):
        load("cc0-hand").evaluate(np.zeros((1, 10)), np.zeros((1, 16, 3)), None, np.zeros(3))  # type: ignore[arg-type]
