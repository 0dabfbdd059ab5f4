"""Rectification."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from speckle import pair_of_cameras

from synthgen.errors import ShapeError
from synthgen.geometry.cameras import project
from synthgen.sampling.streams import stream
from synthgen.scanner.rectify import (
    rectified_pixels,
    rectify,
    rectify_images,
    remap_tables,
)

DISTORTION = (-0.12, 0.05, 0.001, -0.0005, 0.0)
POINTS = stream(0, "sample", 0, 0, "points").uniform(-0.02, 0.02, (200, 3))


def test_reference_points_come_back() -> None:
    left, right = pair_of_cameras(distortion=DISTORTION)
    pair = rectify(left, right)
    a = rectified_pixels(pair, 0, project(left, POINTS)[0])
    b = rectified_pixels(pair, 1, project(right, POINTS)[0])
    assert np.abs(a[:, 1] - b[:, 1]).max() < 1e-6
    assert np.abs(pair.points(a[:, 0], a[:, 1], a[:, 0] - b[:, 0]) - POINTS).max() < 1e-9
    centre = pair.points(*rectified_pixels(pair, 0, project(left, np.zeros((1, 3)))[0]).T, 0.0)
    assert np.abs(centre).max() < 1e-9, "the target has disparity zero"


def test_reference_Q_is_the_same_map() -> None:
    pair = rectify(*pair_of_cameras())
    x, y, d = POINTS.T * 1000
    h = np.stack([x, y, d, np.ones_like(x)], axis=1) @ pair.Q.T
    world = (h[:, :3] / h[:, 3:]) @ pair.camera.T[:3, :3].T + pair.camera.T[:3, 3]
    assert np.abs(world - pair.points(x, y, d)).max() < 1e-9
    assert np.abs(pair.disparity(pair.depth(d)) - d).max() < 1e-8


def test_reference_tables_invert_the_pixel_map() -> None:
    pair = rectify(*pair_of_cameras(distortion=DISTORTION))
    for side in (0, 1):
        x, y = (table[20:220, 20:300] for table in remap_tables(pair, side))
        back = rectified_pixels(pair, side, np.stack([x.ravel(), y.ravel()], axis=1))
        rows, columns = np.mgrid[20:220, 20:300]
        assert np.abs(back - np.stack([columns.ravel(), rows.ravel()], 1)).max() < 1e-3


def test_edge_bad_pairs() -> None:
    left, right = pair_of_cameras()
    with pytest.raises(ShapeError, match="equal sizes"):
        rectify(left, dataclasses.replace(right, width=100))
    with pytest.raises(ShapeError, match="baseline"):
        rectify(left, left)
    with pytest.raises(ShapeError, match="behind"):
        rectify(left, right, np.array([0.0, 0.0, 2.0]))
    with pytest.raises(ShapeError, match="calibration is for"):
        rectify_images(rectify(left, right), (np.zeros((3, 3)), np.zeros((3, 3))))
