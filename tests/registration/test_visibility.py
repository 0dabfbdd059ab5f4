"""Visible vertices: those near the points that a depth camera measures, and no others."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from synthgen.registration.simulated import cameras_around, view_points
from synthgen.registration.visibility import visible_vertices
from tests.registration.hands import rng, surface, truth


def test_reference_a_depth_camera_agrees() -> None:
    placed = surface().at(truth())
    camera = cameras_around(placed.vertices, 1, 300, rng=rng("eye"))[0]
    points, _ = view_points(placed.vertices, surface().faces, placed.normals, camera)
    near = cKDTree(points).query(placed.vertices)[0] < 0.0015
    seen = visible_vertices(placed, camera.position[None])
    assert np.mean(near == seen) > 0.93
    assert 0.2 < seen.mean() < 0.7


def test_properties_more_eyes_see_more() -> None:
    placed = surface().at(truth())
    eyes = placed.vertices.mean(axis=0) + 0.6 * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]])
    one, all_ = visible_vertices(placed, eyes[:1]), visible_vertices(placed, eyes)
    assert np.all(all_ >= one)
    assert all_.sum() > one.sum()


def test_edge_from_within_nothing_can_be_said() -> None:
    placed = surface().at(truth())
    assert visible_vertices(placed, placed.vertices.mean(axis=0)[None]).all()
