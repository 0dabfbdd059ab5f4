"""Quaternion features, their product, and how they and rotations move."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import model

from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models.pose_features import (
    feature_joints,
    hamilton,
    quaternion_feature,
    rotations_and_features,
)
from synthgen.models.pose_tangents import of_vectors
from synthgen.sampling.streams import stream

IDENTITY = np.array([0.0, 0, 0, 1])


def rotate(q: np.ndarray, x: np.ndarray) -> np.ndarray:
    conjugate = q * [-1, -1, -1, 1]
    return hamilton(hamilton(q, np.append(x, 0)), conjugate)[:3]


def test_reference_quaternions() -> None:
    rng = stream(0, "sample", 0, 0, "quaternions")
    for scale in (1e-9, 1e-5, 1.0, 3.0):
        r, x = rng.normal(0, scale, 3), rng.normal(size=3)
        q = quaternion_feature(r) + IDENTITY
        np.testing.assert_allclose(q @ q, 1, atol=1e-15)
        np.testing.assert_allclose(rotate(q, x), matrix_from_axis_angle(r) @ x, atol=1e-14)


def test_reference_product_is_one_turn_after_another() -> None:
    a, b = np.array([0.3, -1.0, 0.2]), np.array([1.0, 0.5, -0.4])
    product = hamilton(quaternion_feature(a) + IDENTITY, quaternion_feature(b) + IDENTITY)
    x = np.array([1.0, 2.0, 3.0])
    want = matrix_from_axis_angle(a) @ matrix_from_axis_angle(b) @ x
    np.testing.assert_allclose(rotate(product, x), want, atol=1e-14)


def test_properties_small_angles_lose_no_digits() -> None:
    tiny = quaternion_feature(np.array([1e-7, 0, 0]))
    np.testing.assert_allclose(tiny, [5e-8, 0, 0, -1.25e-15], rtol=1e-12)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [("mano", (1, 9)), ("smplh", (1, 9)), ("supr", (0, 4)), ("supr296", (1, 4)), ("star", (1, 4))],
)
def test_reference_feature_joints(kind: str, expected: tuple[int, int]) -> None:
    assert feature_joints(model(kind)) == expected


@pytest.mark.parametrize("kind", ["mano", "star"])
def test_properties_matrices_give_the_same_features(kind: str) -> None:
    made = model(kind)
    pose = stream(0, "sample", 0, 0, "matrices").normal(0, 0.6, (2, len(made.parents), 3))
    a = rotations_and_features(made, pose)
    b = rotations_and_features(made, matrix_from_axis_angle(pose))
    np.testing.assert_allclose(a[0], b[0], atol=1e-14)
    np.testing.assert_allclose(a[1], b[1], atol=1e-14)


@pytest.mark.parametrize("q", [4, 9])
@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-3, 0.09, 0.11, 1.0, 3.0])
def test_reference_tangents_against_finite_differences(q: int, scale: float) -> None:
    """Both sides of the switch between series and quotients, and exactly zero."""
    direction = np.array([0.6, -0.64, 0.48])
    theta = scale * direction[None]
    omega, feature = np.empty((1, 3, 3)), np.empty((1, 3, q))
    of_vectors(theta, matrix_from_axis_angle(theta), omega, feature)
    h = 1e-5
    for c in range(3):
        ahead, behind = (theta[0] + s * h * np.eye(3)[c] for s in (1, -1))
        rate = (matrix_from_axis_angle(ahead) - matrix_from_axis_angle(behind)) / (2 * h)
        spin = rate @ matrix_from_axis_angle(theta[0]).T
        found = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        np.testing.assert_allclose(omega[0, c], found, atol=1e-9)
        if q == 4:
            rate = (quaternion_feature(ahead) - quaternion_feature(behind)) / (2 * h)
        np.testing.assert_allclose(feature[0, c], rate.ravel(), atol=1e-9)
