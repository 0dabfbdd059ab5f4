"""Cameras against OpenCV and plain algebra."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from synthgen.errors import ShapeError
from synthgen.geometry.cameras import (
    Camera,
    camera_from_K,
    distort,
    pixel_rays,
    project,
    to_camera,
    to_world,
    undistort,
)
from synthgen.geometry.transforms import apply, invert, look_at
from synthgen.sampling.streams import stream

K = np.array([[310.0, 0, 161.2], [0, 305.0, 118.7], [0, 0, 1]])
BENT = np.array([-0.21, 0.08, 0.0012, -0.0007, -0.01])
T = look_at(np.array([0.3, 1.4, 0.9]), np.array([0.0, 1.2, 0.0]))


def camera(distortion: np.ndarray | None = None) -> Camera:
    return camera_from_K(K, 320, 240, T, distortion)


def points() -> np.ndarray:
    return stream(0, "sample", 0, 0, "points").normal(0, 0.1, (40, 3)) + [0.0, 1.2, 0.0]


@pytest.mark.parametrize("distortion", [None, BENT])
def test_reference_opencv(distortion: np.ndarray | None) -> None:
    inverse = invert(T)
    rvec = cv2.Rodrigues(inverse[:3, :3])[0]
    coefficients = np.zeros(5) if distortion is None else distortion
    expected = cv2.projectPoints(points(), rvec, inverse[:3, 3], K, coefficients)[0][:, 0]
    pixels, z = project(camera(distortion), points())
    np.testing.assert_allclose(pixels, expected, atol=1e-8)
    np.testing.assert_allclose(z, apply(inverse, points())[:, 2], atol=1e-12)


@pytest.mark.parametrize("distortion", [None, BENT])
def test_properties_rays_hit_their_pixels(distortion: np.ndarray | None) -> None:
    origin, directions = pixel_rays(camera(distortion))
    pixels, _ = project(camera(distortion), origin + 0.8 * directions)
    v, u = np.mgrid[:240, :320]
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-12)


def test_properties_round_trips() -> None:
    c = camera(BENT)
    np.testing.assert_allclose(to_world(c, to_camera(c, points())), points(), atol=1e-12)
    xy = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 9), np.linspace(-0.3, 0.3, 9)), axis=-1)
    np.testing.assert_allclose(undistort(c, distort(c, xy)), xy, atol=1e-9)
    assert undistort(c, np.zeros((0, 2))).shape == (0, 2)


def test_reference_look_at_is_opencv() -> None:
    """The target is on the axis; up in the world is up in the image (smaller v)."""
    c = camera()
    pixels, z = project(c, np.array([[0.0, 1.2, 0.0], [0.0, 1.25, 0.0]]))
    np.testing.assert_allclose(pixels[0], K[:2, 2], atol=1e-9)
    assert z[0] > 0
    assert pixels[1, 1] < pixels[0, 1]


def test_edge_skew_and_folding_distortion() -> None:
    with pytest.raises(ShapeError, match="skew"):
        camera_from_K(K + np.eye(3, k=1), 320, 240)
    with pytest.raises(ShapeError, match="inverted"):
        pixel_rays(camera(np.array([-3.0, 0, 0, 0, 0])))
    with pytest.raises(ShapeError, match="image plane"):
        look_at(np.zeros(3), np.array([0.0, 1.0, 0.0]))
