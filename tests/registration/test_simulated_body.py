"""Simulated scans of bodies: noise, hands, what is lost."""

from __future__ import annotations

from functools import lru_cache

import igl
import numpy as np
import pytest

from synthgen.errors import ShapeError
from synthgen.models import load
from synthgen.registration.simulated_body import (
    BodyScan,
    BodyScanSettings,
    simulate_body_scan,
    units_around,
)
from synthgen.sampling.body_pose import a_pose
from synthgen.sampling.streams import stream


@lru_cache(maxsize=1)
def vertices() -> np.ndarray:
    model = load("cc0-body")
    return model.evaluate(np.zeros((1, 16)), a_pose(model)[None]).vertices[0].astype(np.float64)


@lru_cache(maxsize=8)
def scan(points: int = 40_000, **lost: float) -> BodyScan:
    settings = BodyScanSettings(points=points, lost=lost)
    rng = stream(1, "sample", 0, 0, "body scan")
    return simulate_body_scan(load("cc0-body"), vertices(), settings, rng=rng)


def distance_m(points: np.ndarray) -> np.ndarray:
    faces = np.ascontiguousarray(load("cc0-body").faces, np.int64)
    return np.sqrt(igl.point_mesh_squared_distance(points, vertices(), faces)[0])


def test_smoke_shares() -> None:
    found = scan()
    assert found.points.shape == found.normals.shape
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1)
    assert 0.95 < found.coverage < 1
    assert 0.015 < (found.side == 0).mean() < 0.035
    assert 0.015 < (found.side == 1).mean() < 0.035
    assert (found.side == 2).sum() > 50
    assert abs((found.side == -2).mean() - 0.01) < 0.002
    assert (found.side >= -1).sum() - (found.side == 2).sum() == 40_000


def test_reference_noise_is_what_was_asked() -> None:
    found = scan()
    body = np.median(distance_m(found.points[found.side == -1])) / 0.6745
    hand = np.median(distance_m(found.points[found.side == 0])) / 0.6745
    assert 7.2e-4 < body < 8.5e-4
    assert body < hand < 2e-3


def test_properties_lost_hands() -> None:
    whole, half, none = (np.sum(s.side == 0) for s in (scan(), scan(left=0.5), scan(left=1.0)))
    assert none == 0
    assert 0.4 < half / whole < 0.6
    assert np.sum(scan(left=1.0).side == 1) > 0.9 * np.sum(scan().side == 1)


def test_properties_the_order_is_random_and_repeatable() -> None:
    first, again = scan(), simulate_body_scan(
        load("cc0-body"), vertices(), BodyScanSettings(points=40_000),
        rng=stream(1, "sample", 0, 0, "body scan"),
    )  # fmt: skip
    assert np.array_equal(first.points, again.points)
    thousand = first.points[:1000, 1]
    assert abs(thousand.mean() - first.points[:, 1].mean()) < 0.05


def test_properties_all_units_see_the_whole_body() -> None:
    cameras = units_around(vertices())
    assert len(cameras) == 22
    for camera in cameras:
        local = (vertices() - camera.position) @ camera.T[:3, :3]
        pixel = local[:, :2] / local[:, 2:] * camera.fx + camera.cx
        assert pixel.min() > -0.5
        assert pixel.max() < camera.width - 0.5


@pytest.mark.parametrize("lost", [{"middle": 0.5}, {"left": 1.5}])
def test_edge_errors(lost: dict[str, float]) -> None:
    with pytest.raises(ShapeError, match="expected 'left' or 'right'"):
        simulate_body_scan(load("cc0-body"), vertices(), BodyScanSettings(lost=lost),
                           rng=stream(1, "sample", 0, 0, "x"))  # fmt: skip
