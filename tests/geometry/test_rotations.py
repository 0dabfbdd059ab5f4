"""Rotations against SciPy, and right derivatives at zero."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import (
    axis_angle_from_matrix,
    matrix_from_axis_angle,
    swing_between,
)
from synthgen.sampling.streams import stream


def vectors(n: int, scale: float) -> np.ndarray:
    return stream(0, "sample", 0, 0, "rotations").standard_normal((n, 3)) * scale


@pytest.mark.parametrize("scale", [1e-9, 1e-5, 1e-3, 1.0, 3.0])
def test_reference_scipy(scale: float) -> None:
    r = vectors(50, scale)
    np.testing.assert_allclose(
        matrix_from_axis_angle(r), Rotation.from_rotvec(r).as_matrix(), atol=1e-14
    )


def test_properties_second_derivative_at_zero() -> None:
    """The (2, 2) entry is cos(angle) about x: its second derivative at zero is -1."""
    h = 1e-3
    row = [matrix_from_axis_angle(np.array([s, 0.0, 0.0]))[2, 2] for s in (-h, 0.0, h)]
    assert (row[0] - 2 * row[1] + row[2]) / h**2 == pytest.approx(-1.0, abs=1e-5)


def test_properties_round_trip() -> None:
    r = vectors(50, 1.0)
    np.testing.assert_allclose(axis_angle_from_matrix(matrix_from_axis_angle(r)), r, atol=1e-12)


def test_properties_swing_takes_a_to_b_by_the_smallest_turn() -> None:
    a, b = vectors(20, 1.0), vectors(20, 1.0)[::-1]
    turned = (swing_between(a, b) @ a[..., None])[..., 0]
    np.testing.assert_allclose(np.cross(turned, b), 0, atol=1e-9)
    assert np.all(np.sum(turned * b, axis=1) > 0)


def test_edge_bad_shapes_and_opposite_directions() -> None:
    with pytest.raises(ShapeError, match="end in 3"):
        matrix_from_axis_angle(np.zeros(4))
    with pytest.raises(ShapeError, match="opposite"):
        swing_between(np.array([1.0, 0, 0]), np.array([-1.0, 0, 0]))
