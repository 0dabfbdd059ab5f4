"""Points, normals and noise of scans."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from synthgen.errors import ShapeError
from synthgen.registration.scan import bulge, checked_points, estimate_normals, scan_of
from synthgen.registration.simulated import ScanSettings, simulate_scan, with_detail
from synthgen.registration.verdict import MISFIT
from tests.registration.hands import rng, scan, scanned, surface, truth


def test_smoke_order_is_random_and_repeatable() -> None:
    points, normals = scanned()
    a, b = scan_of(points, normals), scan_of(points, normals)
    np.testing.assert_array_equal(a.points, b.points)
    assert not np.array_equal(a.points, points)


def test_properties_estimated_normals_point_outwards() -> None:
    points, normals = scanned()
    some = rng("some").permutation(len(points))[:4000]
    found = estimate_normals(points[some])
    assert np.median(np.sum(found * normals[some], axis=1)) > 0.9
    eye = points.mean(axis=0) + 0.6 * normals[some].mean(axis=0)
    assert np.isfinite(estimate_normals(points[some], eye[None])).all()


def test_properties_bulge_tells_flipped_normals() -> None:
    assert bulge(scan().points, scan().normals) > 0.1
    assert bulge(scan().points, -scan().normals) < -0.1


@pytest.mark.parametrize("noise_m", [2e-4, 5e-4, 7e-4, 1e-3])
def test_reference_local_noise(noise_m: float) -> None:
    """Near enough not to take noise for a misfit of the model."""
    found = scan_of(*scanned(7, noise_m)).local_noise_m
    assert noise_m / MISFIT < found < 1.15 * noise_m


def test_properties_few_points_tell_no_more_of_the_noise_from_farther_away() -> None:
    points, normals = (a[:1500] for a in scanned(7, 1e-3))
    few = scan_of(points, normals)
    assert few.local_noise_m == few._scatter_m(12)[0]


def test_edge_bad_points_are_dropped_and_counted() -> None:
    points, normals = (a[:100].copy() for a in scanned())
    points[3] = np.nan
    normals[5] = 0
    p, n, dropped = checked_points(points, normals)
    assert n is not None
    assert (len(p), len(n), dropped) == (98, 98, 2)
    with pytest.raises(ShapeError, match="normals have shape"):
        checked_points(points, normals[:10])
    with pytest.raises(ShapeError, match="expected \\(N, 3\\)"):
        checked_points(points.ravel(), None)


@pytest.mark.parametrize("eyes", [[1.0, 2.0], np.zeros((0, 3)), [[0.0, np.nan, 1.0]]])
def test_edge_viewpoints_are_checked(eyes: Any) -> None:
    with pytest.raises(ShapeError, match="viewpoints"):
        scan_of(*scanned(), eyes)


def test_properties_simulated_points_lie_on_the_surface() -> None:
    import igl

    s = surface()
    vertices = s.at(truth()).vertices
    settings = ScanSettings(points=3000, noise_m=0, outliers=0, normal_noise=0, pixels=120)
    points, normals, seen = simulate_scan(vertices, s.faces, settings, rng=rng("clean"))
    squared = igl.point_mesh_squared_distance(points, vertices, s.faces)[0]
    assert np.sqrt(squared.max()) < 1e-9
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-9)
    assert 0.3 < seen.mean() < 1.0


def test_properties_detail_has_its_amplitude() -> None:
    vertices = surface().at(truth()).vertices
    for rough in (0.0, 1 / 3):
        moved = with_detail(vertices, surface().faces, 6e-4, rng=rng("bumps"), rough=rough)
        size = np.linalg.norm(moved - vertices, axis=1)
        assert abs(np.sqrt(np.mean(size**2)) - 6e-4) < 1e-4
