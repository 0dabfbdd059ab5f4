"""Interpolating subdivision: passes through its vertices, keeps planes, books its children."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from synthgen.errors import ShapeError
from synthgen.geometry.subdivision import InterpolatingSubdivision


def sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=2)


def disc() -> tuple[np.ndarray, np.ndarray]:
    """A flat open patch: 5 x 5 grid."""
    x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
    v = np.stack([x.ravel(), y.ravel(), 0.3 * x.ravel() + 0.1], axis=1)
    a = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    f = np.concatenate([np.stack([a, a + 1, a + 6], 1), np.stack([a, a + 6, a + 5], 1)])
    return v, f


@pytest.mark.parametrize("levels", [0, 1, 2])
def test_properties_passes_through_the_vertices(levels: int) -> None:
    mesh = sphere()
    s = InterpolatingSubdivision.build(mesh.faces, len(mesh.vertices), levels)
    refined = s.apply(mesh.vertices)
    np.testing.assert_allclose(refined[: len(mesh.vertices)], mesh.vertices, atol=1e-12)
    assert len(s.faces) == len(mesh.faces) * 4**levels


def test_reference_sphere_is_nearer_than_flat_refinement() -> None:
    mesh = sphere()
    s = InterpolatingSubdivision.build(mesh.faces, len(mesh.vertices), 2)
    smooth = np.abs(np.linalg.norm(s.apply(mesh.vertices), axis=1) - 1).max()
    flat = np.abs(np.linalg.norm(s.linear @ mesh.vertices, axis=1) - 1).max()
    assert smooth < 0.25 * flat


def test_properties_planes_stay_planes() -> None:
    v, f = disc()
    refined = InterpolatingSubdivision.build(f, len(v), 2).apply(v)
    np.testing.assert_allclose(refined[:, 2], 0.3 * refined[:, 0] + 0.1, atol=1e-12)


def test_properties_children_know_their_parents() -> None:
    mesh = sphere()
    s = InterpolatingSubdivision.build(mesh.faces, len(mesh.vertices), 2)
    flat = s.linear @ mesh.vertices
    corners = mesh.vertices[mesh.faces]
    expected = np.einsum("cij,fjk->fcik", s.corner_barycentrics, corners).reshape(-1, 3, 3)
    np.testing.assert_allclose(flat[s.faces], expected, atol=1e-12)


def test_properties_orientation_is_kept() -> None:
    mesh = sphere()
    s = InterpolatingSubdivision.build(mesh.faces, len(mesh.vertices), 1)
    refined = trimesh.Trimesh(s.apply(mesh.vertices), s.faces, process=False)
    assert refined.is_watertight
    assert refined.volume == pytest.approx(4 / 3 * np.pi, rel=0.01)


def test_edge_bad_meshes() -> None:
    fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    with pytest.raises(ShapeError, match="3 faces"):
        InterpolatingSubdivision.build(fan, 5, 1)
    with pytest.raises(ShapeError, match="no face"):
        InterpolatingSubdivision.build(fan[:1], 5, 1)
    with pytest.raises(ShapeError, match="levels=9"):
        InterpolatingSubdivision.build(fan[:1], 3, 9)
