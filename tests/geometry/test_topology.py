"""Boundaries and normals of small meshes that can be checked by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from synthgen.errors import ShapeError
from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.topology import boundary_edges, boundary_loops, pieces


def test_reference_open_tube() -> None:
    tube = trimesh.creation.cylinder(1.0, 2.0, sections=12)
    side = tube.faces[np.abs(tube.face_normals[:, 2]) < 0.5]
    loops = boundary_loops(side)
    assert [len(loop) for loop in loops] == [12, 12]
    present = {(a, b) for f in side for a, b in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))}
    for loop in loops:  # along the faces' own edges
        assert all((a, b) in present for a, b in zip(loop, np.roll(loop, -1), strict=True))


def test_smoke_closed_mesh_has_no_boundary() -> None:
    assert boundary_loops(trimesh.creation.box().faces) == []
    assert len(boundary_edges(trimesh.creation.box().faces)) == 0


def test_edge_touching_in_a_point() -> None:
    with pytest.raises(ShapeError, match="several boundary loops"):
        boundary_loops(np.array([[0, 1, 2], [0, 3, 4]]))


def test_edge_a_boundary_that_does_not_close() -> None:
    doubled = np.array([[3, 2, 1], [2, 0, 1], [1, 0, 2], [2, 1, 0]])
    with pytest.raises(ShapeError, match=r"ends at vertex \d; .* edge-manifold"):
        boundary_loops(doubled)


def test_reference_sphere_normals() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    normals = vertex_normals(ball.vertices, ball.faces)
    assert np.sum(normals * ball.vertices, axis=1).min() > 0.999


def test_reference_edges_one_by_one() -> None:
    """Against sets of pairs, on triangles at random: doubled, degenerate and unused ones too."""
    rng = np.random.Generator(np.random.Philox(7))
    for n in (4, 9, 60):
        faces = rng.integers(0, n, (40, 3))
        pairs = {(int(f[k]), int(f[(k + 1) % 3])) for f in faces for k in range(3)}
        expected = sorted((a, b) for a, b in pairs if (b, a) not in pairs)
        assert boundary_edges(faces).tolist() == [list(pair) for pair in expected]
    assert boundary_edges(np.zeros((0, 3), int)).shape == (0, 2)


def test_properties_pieces() -> None:
    faces = np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6]])
    piece = pieces(faces, 8)
    assert len(set(piece[:4])) == len(set(piece[4:7])) == 1
    assert len({piece[0], piece[4], piece[7]}) == 3
