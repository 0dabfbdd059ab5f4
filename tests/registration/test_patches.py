"""Means of residuals around vertices: white beside the truth, biased beside a bent finger."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.subdivision import InterpolatingSubdivision
from synthgen.registration import fit
from synthgen.registration.correspondences import closest
from synthgen.registration.patches import LEAST_POINTS, Patches, patches_of
from synthgen.registration.statistics import PARTS, part_of_vertex
from tests.registration.hands import model, rng, scan, surface, truth

NOISE_M = 2e-4


def beside(x: np.ndarray, vertices: np.ndarray | None = None) -> Patches:
    placed, some = surface().at(x), scan()
    if vertices is not None:
        placed.vertices[:] = vertices
    pairs = closest(placed, some.points, some.normals, cut_m=0.01, cosine=-2.0)
    return patches_of(placed, pairs, some.points, some.normals, NOISE_M)


def shares(patches: Patches) -> np.ndarray:
    return patches.biased_share(part_of_vertex(model()), len(PARTS))


def test_properties_the_truth_is_white() -> None:
    found = beside(truth())
    assert np.nanmax(shares(found)) < 0.02
    assert found.misfit_m == 0
    assert found.effective(30_000) == pytest.approx(30_000)


def test_properties_a_bent_finger_is_biased_and_only_it() -> None:
    x = truth().copy()
    at = surface().fingers.start + 9 * 2  # pinky: third finger of MANO's order
    x[at : at + 3] += [0.0, 0.0, np.deg2rad(1.0)]
    found = dict(zip(PARTS, shares(beside(x)), strict=True))
    assert found["pinky"] > 0.2
    assert max(found["index"], found["thumb"], found["ring"]) < 0.03


def test_properties_detail_tells_less_than_noise() -> None:
    from synthgen.registration.simulated import with_detail

    bumpy = with_detail(surface().at(truth()).vertices, surface().faces, 5e-4, rng=rng("detail"))
    found = beside(truth(), bumpy)
    assert 2e-4 < found.misfit_m < 8e-4
    assert found.effective(30_000) < 3000
    assert np.nanmedian(shares(found)) > 0.1


def test_properties_exact_depth_of_few_points_is_no_misfit() -> None:
    """1,500 exact points of smooth skin: 0.05 mm of the triangles' limits leave them their say."""
    smooth = InterpolatingSubdivision.build(surface().faces, len(surface().at(truth()).vertices))
    points = smooth.apply(surface().at(truth()).vertices)
    normals = vertex_normals(points, smooth.faces)
    some = rng("some").permutation(len(points))[:1500]
    shape, pose, translation = surface().unpack(truth())
    found = fit(
        points[some], normals[some], model(), (shape, pose, translation), "right", curved=0.5
    )
    assert found.verdict == "pass"
    assert np.linalg.norm(found.vertices - surface().at(truth()).vertices, axis=1).mean() < 1.5e-4


def test_edge_few_points_say_nothing() -> None:
    empty = Patches(np.full(50, LEAST_POINTS - 1.0), np.full(50, 1e-3), NOISE_M)
    assert not empty.biased.any()
    assert empty.misfit_m == 0
    assert np.isnan(empty.biased_share(np.zeros(50, np.int64), 1)).all()
