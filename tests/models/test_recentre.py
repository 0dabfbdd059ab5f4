"""Poses in another frame give the moved mesh; the root turns about joint 0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import FAMILIES, draw, model

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import BodyModel, recentre


@pytest.fixture(scope="module", params=FAMILIES)
def made(request: pytest.FixtureRequest) -> BodyModel:
    return model(request.param)


def motion() -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = matrix_from_axis_angle(np.array([0.4, -2.0, 0.9])), [1.0, 2.0, -3.0]
    return T


def test_reference_vertices_move_rigidly(made: BodyModel) -> None:
    given, T = draw(made, 3), motion()
    if made.family == "supr" and made.posedirs.shape[2] == 4 * len(made.parents):
        made = replace(made, posedirs=made.posedirs * (np.arange(made.posedirs.shape[2]) >= 4))
    pose, moved = recentre(made, given.shape, given.pose, given.translation, T, given.expression)
    before, joints = made.evaluate_reference(*given)
    after, joints_after = made.evaluate_reference(given.shape, pose, moved, given.expression)
    np.testing.assert_allclose(after, before @ T[:3, :3].T + T[:3, 3], atol=1e-12)
    np.testing.assert_allclose(joints_after, joints @ T[:3, :3].T + T[:3, 3], atol=1e-12)


def test_reference_root_turns_about_joint_zero(made: BodyModel) -> None:
    """Without moving the translation, joint 0 stays where it is, whatever the root."""
    given = draw(made, 3)
    joints = made.evaluate_joints(*given)
    psi = [None] * 3 if given.expression is None else given.expression
    for b in range(3):
        rest = made.shaped(given.shape[b], psi[b])[1][0]
        np.testing.assert_allclose(joints[b, 0], rest + given.translation[b], atol=1e-6)


def test_properties_matrices(made: BodyModel) -> None:
    if made.axis_meta is not None:
        pytest.skip("a constrained tree is driven by angles")
    given, T = draw(made, 2), motion()
    a, at = recentre(made, given.shape, given.pose, given.translation, T)
    turned = matrix_from_axis_angle(given.pose)
    b, bt = recentre(made, given.shape, turned, given.translation, T)
    np.testing.assert_allclose(matrix_from_axis_angle(a), b, atol=1e-12)
    np.testing.assert_array_equal(at, bt)


def test_properties_there_and_back(made: BodyModel) -> None:
    given, T = draw(made, 2), motion()
    pose, moved = recentre(made, given.shape, given.pose, given.translation, T)
    again, back = recentre(made, given.shape, pose, moved, np.linalg.inv(T))
    np.testing.assert_allclose(again, given.pose, atol=1e-10)
    np.testing.assert_allclose(back, given.translation, atol=1e-10)


def test_edge_not_rigid() -> None:
    made = model("mano")
    given = draw(made, 1)
    nowhere = np.eye(4)
    nowhere[0, 3] = np.nan
    for bad in (
        np.diag([2.0, 2, 2, 1]),
        np.diag([-1.0, 1, 1, 1]),
        np.full((4, 4), np.nan),
        nowhere,
    ):
        with pytest.raises(ShapeError, match="not rigid"):
            recentre(made, given.shape, given.pose, given.translation, bad)
    with pytest.raises(ShapeError, match=r"\(3, 3\); expected \(4, 4\) or \(1, 4, 4\)"):
        recentre(made, given.shape, given.pose, given.translation, np.eye(3))
