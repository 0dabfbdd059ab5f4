"""Scans far from the origin, such as georeferenced ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from synthgen.errors import ShapeError
from synthgen.registration import fit
from synthgen.registration.far import origin_of
from tests.registration.hands import error_mm, model, perturbed, scanned, surface, truth

PLACE = np.array([4.5e5, 112.0, 5.2e6])


def test_reference_origin() -> None:
    points = scanned()[0]
    assert origin_of(points) is None
    assert origin_of(np.zeros((0, 3))) is None
    assert origin_of(np.zeros(3)) is None
    origin = origin_of(np.concatenate([points + PLACE, np.full((9, 3), np.nan)]))
    assert origin is not None
    assert np.abs(origin - PLACE).max() < 1
    np.testing.assert_array_equal(origin, np.rint(origin))


def test_properties_a_cold_fit_is_the_same_far_away() -> None:
    points, normals = scanned()
    found = fit(points + PLACE, normals, model(), "cold", "right", coupled=True)
    assert found.verdict == "pass"
    assert error_mm(found.vertices - PLACE) < 0.1
    posed = surface().at(surface().pack(found.shape, found.pose, found.translation))
    np.testing.assert_allclose(posed.vertices, found.vertices, atol=1e-6)
    assert found.free_vertices is not None
    assert error_mm(found.free_vertices - PLACE) < 0.5
    np.testing.assert_allclose(found.joints - PLACE, posed.joints - PLACE, atol=1e-6)


def test_properties_what_is_known_is_known_far_away() -> None:
    points, normals = scanned()
    shape, pose, translation = perturbed()
    placed = surface().at(truth())
    eyes = placed.vertices.mean(axis=0) + 0.6 * np.eye(3)
    known: dict[str, Any] = {"viewpoints": eyes, "keypoints": (np.arange(4), placed.joints[:4])}
    near = fit(points, normals, model(), (shape, pose, translation), "right", **known)
    known = {"viewpoints": eyes + PLACE, "keypoints": (np.arange(4), placed.joints[:4] + PLACE)}
    start = (shape, pose, translation + PLACE)
    found = fit(points + PLACE, normals, model(), start, "right", **known)
    np.testing.assert_allclose(found.vertices - PLACE, near.vertices, atol=1e-5)


def test_edge_wrong_arguments_are_named_far_away() -> None:
    points, normals = scanned()
    with pytest.raises(ShapeError, match="start has shape"):
        fit(points + PLACE, normals, model(), (np.zeros(10), np.zeros(3), np.zeros(3)))
