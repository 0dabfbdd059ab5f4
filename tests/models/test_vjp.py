"""The pull-back is the transpose of the Jacobian."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import FAMILIES, draw, model

from synthgen.errors import ShapeError
from synthgen.models import BodyModel
from synthgen.models.vjp import forward
from synthgen.sampling.streams import stream


@pytest.fixture(scope="module", params=FAMILIES)
def made(request: pytest.FixtureRequest) -> BodyModel:
    return model(request.param)


@pytest.mark.parametrize(("dtype", "limit"), [(np.float64, 1e-7), (np.float32, 2e-6)])
def test_reference_transpose_of_the_jacobian(
    made: BodyModel, dtype: type[np.float32] | type[np.float64], limit: float
) -> None:
    """<g, J x> = <J' g, x> for every parameter x, through vertices and joints together."""
    given, rng = draw(made, 3), stream(0, "sample", 0, 0, "vjp")
    state = forward(made, *given, dtype=dtype)
    on_vertices = rng.normal(size=state.vertices.shape)
    on_joints = rng.normal(size=state.joints.shape)
    found = state.pull(on_vertices, on_joints)
    jacobian = made.jacobian(*given)
    want = np.einsum("bvc,bvcd->bd", on_vertices, jacobian.values)
    want += np.einsum("bkc,bkcd->bd", on_joints, jacobian.joint_values)
    parts = (found.shape, found.pose, found.translation, found.expression)
    got = np.concatenate([p.reshape(3, -1) for p in parts], axis=1)
    np.testing.assert_allclose(got, want, atol=limit * np.abs(want).max())


def test_reference_forward_is_the_evaluation(made: BodyModel) -> None:
    given = draw(made, 4)
    state, posed = forward(made, *given), made.evaluate(*given)
    np.testing.assert_array_equal(state.vertices, posed.vertices)
    double = forward(made, *given, dtype=np.float64)
    np.testing.assert_allclose(double.vertices, made.evaluate_reference(*given)[0], atol=1e-12)


def test_properties_shapes_follow_the_arguments(made: BodyModel) -> None:
    given = draw(made, 2)
    found = forward(made, given.shape[:, :3], given.pose).pull()
    assert found.shape.shape == (2, 3)
    assert found.pose.shape == given.pose.shape
    assert found.expression.shape == (2, 0)
    assert not any(np.any(p) for p in (found.shape, found.pose, found.translation))


def test_edge_gradient_of_another_shape(made: BodyModel) -> None:
    state = forward(made, *draw(made, 2))
    with pytest.raises(ShapeError, match="on_vertices is"):
        state.pull(np.zeros((1, 3)))
