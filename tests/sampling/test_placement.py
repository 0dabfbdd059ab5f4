"""Placement: fill, offset and arms that leave the picture."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.errors import SamplingError
from synthgen.sampling import placement
from synthgen.sampling.streams import stream


def rng(name: str) -> np.random.Generator:
    return stream(9, "sample", 0, 0, name)


def project(points: np.ndarray, lens: placement.Lens, transform: np.ndarray) -> np.ndarray:
    """Pinhole by hand: independent of the geometry room."""
    local = (points - transform[:3, 3]) @ transform[:3, :3]
    centre = np.array([lens.width, lens.height]) / 2 - 0.5
    return lens.focal_px * local[:, :2] / local[:, 2:] + centre


@pytest.mark.parametrize("fill", [0.3, 0.7, 1.0])
def test_reference_fill_and_offset(fill: float) -> None:
    g = rng("fill")
    points = g.normal(0, 0.04, (300, 3)) + np.array([0.1, 1.2, -0.3])
    lens = placement.sample_lens(320, 240, (35.0, 60.0), rng=g)
    offset = np.array([0.05, -0.08])
    view = placement.sample_view(rng=g)
    transform, distance = placement.camera_position(points, lens, fill, offset, view)
    pixels = project(points, lens, transform)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    assert (high - low).max() == pytest.approx(fill * 240, rel=0.02)
    centre = (low + high) / 2 - [159.5, 119.5]
    np.testing.assert_allclose(centre, offset * [320, 240], atol=3.0)
    assert distance > 0.12


def test_reference_field_of_view() -> None:
    lens = placement.sample_lens(640, 480, (50.0, 50.0), rng=rng("fov"))
    assert 2 * np.rad2deg(np.arctan(320 / lens.focal_px)) == pytest.approx(50.0)


def test_properties_views_are_rotations_that_stand_upright() -> None:
    g = rng("view")
    for _ in range(200):
        view = placement.sample_view(rng=g)
        np.testing.assert_allclose(view.T @ view, np.eye(3), atol=1e-12)
        assert np.linalg.det(view) == pytest.approx(1.0)
        assert view[1, 1] < 0  # image down points down in the world


def lens_at_origin() -> placement.Lens:
    return placement.Lens(200, 200, 200.0, 53.13)


def test_edge_arm_end_in_frame_is_seen() -> None:
    camera = lens_at_origin().camera(np.eye(4))
    inside, outside = np.array([[0.0, 0, 1]]), np.array([[2.0, 0, 1]])
    assert not placement.arm_leaves_frame(inside, inside, (camera,))
    assert placement.arm_leaves_frame(outside, outside, (camera,))
    behind = np.array([[0.0, 0, -1]])
    assert placement.arm_leaves_frame(behind, behind, (camera,))


def test_edge_arm_too_near() -> None:
    camera = lens_at_origin().camera(np.eye(4))
    end, arm = np.array([[2.0, 0, 1]]), np.array([[0.0, 0, 0.9 * placement.NEAREST_ARM_M]])
    assert not placement.arm_leaves_frame(end, arm, (camera,))


def test_edge_no_arm_is_an_error_that_says_what_to_change() -> None:
    with pytest.raises(SamplingError, match=r"camera\.fill"):
        placement.require_arm(None, 3, 10)
