"""The fitter's skin against the models' float64 reference, and its derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.registration.surface import Surface, left_jacobian
from tests.registration.hands import model, rng, surface


def vector() -> np.ndarray:
    return rng("vector").normal(0, 0.3, surface().n)


def test_smoke_shapes() -> None:
    placed = surface().at(vector())
    assert placed.vertices.shape == (surface().n_vertices, 3)
    assert placed.jacobian.shape == (surface().n_vertices, 3, surface().n)
    assert placed.joint_jacobian.shape == (16, 3, surface().n)


def test_reference_vertices_and_joints() -> None:
    x = vector()
    shape, pose, translation = surface().unpack(x)
    vertices, joints = model().evaluate_reference(shape[None], pose[None], translation[None])
    placed = surface().at(x)
    np.testing.assert_allclose(placed.vertices, vertices[0], atol=1e-12)
    np.testing.assert_allclose(placed.joints, joints[0], atol=1e-12)


def test_reference_finite_differences() -> None:
    x, h = vector(), 1e-6
    placed = surface().at(x)
    for k in range(0, surface().n, 3):
        step = np.zeros(surface().n)
        step[k] = h
        ahead, behind = surface().at(x + step), surface().at(x - step)
        slope = (ahead.vertices - behind.vertices) / (2 * h)
        np.testing.assert_allclose(placed.jacobian[:, :, k], slope, atol=1e-8)
        slope = (ahead.joints - behind.joints) / (2 * h)
        np.testing.assert_allclose(placed.joint_jacobian[:, :, k], slope, atol=1e-8)


def test_properties_pack_and_unpack_are_inverse() -> None:
    x = vector()
    np.testing.assert_array_equal(surface().pack(*surface().unpack(x)), x)


def test_properties_rim_is_the_wrist_ring() -> None:
    assert surface().rim.sum() == 20


@pytest.mark.parametrize("scale", [0.0, 1e-5, 1e-2, 2.0])
def test_reference_left_jacobian(scale: float) -> None:
    from scipy.spatial.transform import Rotation

    theta, h = scale * np.array([0.3, -0.5, 0.8]), 1e-6
    for k in range(3):
        step = h * np.eye(3)[k]
        turn = Rotation.from_rotvec(theta + step) * Rotation.from_rotvec(theta - step).inv()
        slope = turn.as_rotvec() / (2 * h)
        np.testing.assert_allclose(left_jacobian(theta[None])[0][:, k], slope, atol=1e-7)


def test_edge_other_families_are_refused() -> None:
    from dataclasses import replace

    with pytest.raises(ModelError, match="star"):
        Surface(replace(model(), family="star"))
