"""Orientation: uniform on SO(3), or within a cone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from synthgen.errors import SamplingError
from synthgen.sampling.orientation import (
    BACK_TO_CAMERA,
    cone_rotation,
    mirror_rotation,
    uniform_rotation,
)
from synthgen.sampling.streams import stream

N = 4000


def rng(name: str) -> np.random.Generator:
    return stream(5, "sample", 0, 0, name)


def check_haar(rotations: np.ndarray) -> None:
    """Rotation angle and images of fixed vectors follow the Haar measure."""
    trace = np.trace(rotations, axis1=1, axis2=2)
    angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    assert stats.kstest(angle, lambda t: (t - np.sin(t)) / np.pi).pvalue > 0.01
    for axis in range(3):
        for row in range(3):
            uniform = stats.kstest(rotations[:, row, axis], stats.uniform(-1, 2).cdf)
            assert uniform.pvalue > 0.001


def test_properties_uniform_is_haar() -> None:
    g = rng("haar")
    rotations = np.array([uniform_rotation(rng=g) for _ in range(N)])
    check_haar(rotations)
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (N, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-12)


def test_properties_one_angle_for_three_axes_would_be_caught() -> None:
    """The known defect: the same angle about x, y and z reaches a curve, not SO(3)."""
    angles = rng("defect").uniform(0, 2 * np.pi, N)
    c, s, z, o = np.cos(angles), np.sin(angles), np.zeros(N), np.ones(N)
    rx = np.stack([o, z, z, z, c, -s, z, s, c], 1).reshape(N, 3, 3)
    ry = np.stack([c, z, s, z, o, z, -s, z, c], 1).reshape(N, 3, 3)
    rz = np.stack([c, -s, z, s, c, z, z, z, o], 1).reshape(N, 3, 3)
    with pytest.raises(AssertionError):
        check_haar(rx @ ry @ rz)


def test_properties_full_cone_is_haar() -> None:
    g = rng("full")
    check_haar(np.array([cone_rotation(180.0, rng=g) for _ in range(N)]))


def test_properties_cone_bounds_the_dorsal_axis() -> None:
    g = rng("cone")
    rotations = np.array([cone_rotation(40.0, rng=g) for _ in range(N)])
    towards_camera = -rotations[:, 2, 1]
    assert towards_camera.min() >= np.cos(np.deg2rad(40.0)) - 1e-12
    # uniform over the cap: the cosine is uniform
    low = np.cos(np.deg2rad(40.0))
    assert stats.kstest(towards_camera, stats.uniform(low, 1 - low).cdf).pvalue > 0.01


def test_reference_back_of_a_right_hand() -> None:
    """Back to the camera, fingers up: the thumb of a right hand is on the left."""
    fingers, thumb, dorsal = [-1, 0, 0], [0, 0, 1], [0, 1, 0]
    np.testing.assert_array_equal(BACK_TO_CAMERA @ fingers, [0, -1, 0])
    np.testing.assert_array_equal(BACK_TO_CAMERA @ thumb, [-1, 0, 0])
    np.testing.assert_array_equal(BACK_TO_CAMERA @ dorsal, [0, 0, -1])
    assert np.linalg.det(BACK_TO_CAMERA) == pytest.approx(1.0)


def test_properties_mirror_keeps_rotations() -> None:
    mirrored = mirror_rotation(uniform_rotation(rng=rng("mirror")))
    np.testing.assert_allclose(mirrored @ mirrored.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


@pytest.mark.parametrize("cone", [0.0, -3.0, 181.0])
def test_edge_bad_cone(cone: float) -> None:
    with pytest.raises(SamplingError, match="cone_deg"):
        cone_rotation(cone, rng=rng("bad"))
