"""Analytic derivatives against the product rule in NumPy and against finite differences."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from random_models import FAMILIES, Draw, draw, model

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import BodyModel, load_hand
from synthgen.models.jacobian_reference import jacobian_reference


@pytest.fixture(scope="module", params=FAMILIES)
def made(request: pytest.FixtureRequest) -> BodyModel:
    return model(request.param, pairs=12, betas=4)


def flat(given: Draw) -> np.ndarray:
    return np.concatenate([np.ravel(a) for a in given if a is not None])


def function(made: BodyModel, given: Draw) -> Callable[[np.ndarray], list[np.ndarray]]:
    """Vertices and joints of one sample as a function of all parameters in one vector."""
    sizes = np.cumsum([0] + [np.size(a) for a in given if a is not None])

    def at(x: np.ndarray) -> list[np.ndarray]:
        parts = [x[i:j] for i, j in pairwise(sizes)]
        parts[1] = parts[1].reshape(given.pose.shape)
        return [r[0] for r in made.evaluate_reference(*(p[None] for p in parts))]

    return at


@pytest.mark.parametrize("b", [0, 1])
def test_reference_finite_differences(made: BodyModel, b: int) -> None:
    """Sample 1 has the zero pose, where careless formulas divide by zero."""
    given = draw(made, 2).one(b)
    found = made.jacobian(*given)
    at, x, h = function(made, given), flat(given), 1e-5
    vertices, joints = at(x)
    np.testing.assert_allclose(found.vertices, vertices, atol=1e-7)
    np.testing.assert_allclose(found.joints, joints, atol=1e-12)
    for i in range(len(x)):
        step = h * np.eye(1, len(x), i)[0]
        (v1, j1), (v0, j0) = at(x + step), at(x - step)
        np.testing.assert_allclose(found.values[..., i], (v1 - v0) / (2 * h), atol=1e-6)
        np.testing.assert_allclose(found.joint_values[..., i], (j1 - j0) / (2 * h), atol=1e-8)


@pytest.mark.parametrize("b", [0, 1])
def test_reference_product_rule(made: BodyModel, b: int) -> None:
    given = draw(made, 2).one(b)
    plain = jacobian_reference(made, given.shape, given.pose, given.expression)
    np.testing.assert_allclose(made.jacobian(*given).values, plain, atol=1e-7)


def test_reference_matrices_turn_from_the_left(made: BodyModel) -> None:
    if made.axis_meta is not None:
        pytest.skip("a constrained tree is driven by angles")
    given = draw(made, 1).one(0)
    turned = matrix_from_axis_angle(given.pose)
    found = made.jacobian(given.shape, turned, given.translation, given.expression)
    h = 1e-5
    for k in (0, 3, len(made.parents) - 1):
        for c in range(3):
            sides = []
            for sign in (1, -1):
                moved = turned.copy()
                moved[k] = matrix_from_axis_angle(sign * h * np.eye(3)[c]) @ moved[k]
                psi = None if given.expression is None else given.expression[None]
                batch = (given.shape[None], moved[None], given.translation[None], psi)
                sides.append(made.evaluate_reference(*batch)[0][0])
            slope = (sides[0] - sides[1]) / (2 * h)
            np.testing.assert_allclose(found.pose[..., 3 * k + c], slope, atol=1e-6)


def test_properties_second_order_at_zero() -> None:
    """Differences of the Jacobian at the zero pose are the true second derivatives there.

    With the usual rodrigues (angle = |r + 1e-8|) they are 0 instead of -1 on the diagonal.
    """
    made = model("mano")
    h, beta = 1e-4, np.zeros(6)
    pose = np.zeros((16, 3))
    joint0 = made.shaped(beta)[1][0]
    for c in range(3):
        ahead, behind = pose.copy(), pose.copy()
        ahead[0, c], behind[0, c] = h, -h
        slope = made.jacobian(beta, ahead).pose[..., c] - made.jacobian(beta, behind).pose[..., c]
        e = np.eye(3)[c]
        want = np.cross(e, np.cross(e, made.v_template - joint0))
        np.testing.assert_allclose(slope / (2 * h), want, atol=1e-6)


def test_properties_rows_and_batch(made: BodyModel) -> None:
    given = draw(made, 3)
    whole, rows = made.jacobian(*given), np.array([5, 0, 5])
    part = made.jacobian(*given, rows=rows)
    np.testing.assert_array_equal(part.values, whole.values[:, rows])
    np.testing.assert_array_equal(part.vertices, whole.vertices[:, rows])
    np.testing.assert_array_equal(made.jacobian(*given.one(2)).values, whole.values[2])


def test_properties_columns(made: BodyModel) -> None:
    found = made.jacobian(*draw(made, 1).one(0))
    parts = (found.shape, found.pose, found.translation, found.expression)
    np.testing.assert_array_equal(np.concatenate(parts, axis=-1), np.asarray(found))
    assert found.pose.shape[-1] == made.n_pose
    np.testing.assert_array_equal(found.translation, np.broadcast_to(np.eye(3), (32, 3, 3)))


def test_properties_columns_that_do_nothing_are_zero() -> None:
    """A finger's numbers move nothing that the finger neither carries nor corrects."""
    hand = load_hand("cc0-hand")
    found = hand.jacobian(np.zeros(10), np.zeros((16, 3))).pose
    far = hand.weights[:, [1, 2, 3]].sum(axis=1) == 0
    still = far & ~np.any(hand.posedirs[..., :27] != 0, axis=(1, 2))
    assert still.sum() > 100
    assert not found[still][..., 3:12].any()
    assert found[~far][..., 3:12].any()


@pytest.mark.parametrize(
    ("rows", "words"),
    [([0, 32], "0..31"), ([-1], "0..31"), ([0.5], "vertex numbers"), ([[0]], "vertex numbers")],
)
def test_edge_bad_rows(rows: list[float], words: str) -> None:
    made = model("mano", pairs=12)
    with pytest.raises(ShapeError, match=words):
        made.jacobian(np.zeros(6), np.zeros((16, 3)), rows=np.array(rows))


def test_edge_no_rows() -> None:
    made = model("mano", pairs=12)
    found = made.jacobian(np.zeros(6), np.zeros((16, 3)), rows=np.zeros(0, dtype=int))
    assert found.values.shape == (0, 3, 6 + 48 + 3)
