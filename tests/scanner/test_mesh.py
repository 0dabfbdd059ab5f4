"""The drawn mesh: splitting moves nothing, and every drawn triangle knows its parent."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from synthgen.scanner import ScanScene, solid_from_mesh
from synthgen.scanner.mesh import drawn_mesh, typical_edge
from tests.scanner.small import PLAIN, ball, wall


@pytest.fixture(scope="module")
def scene() -> ScanScene:
    speed = np.array([0.1, 0.0, 0.0])
    return ScanScene(
        (
            solid_from_mesh(ball(), PLAIN, velocity_m_s=speed),
            solid_from_mesh(wall(), PLAIN, smooth=False),
        )
    )


def test_smoke_fine_enough(scene: ScanScene) -> None:
    drawn = drawn_mesh(scene, 0.001)
    assert typical_edge(drawn.vertices, drawn.faces) <= 0.001
    assert drawn.faces.max() < len(drawn.vertices)
    assert np.allclose(np.linalg.norm(drawn.normals, axis=1), 1)


def test_reference_same_surface(scene: ScanScene) -> None:
    drawn = drawn_mesh(scene, 0.0015)
    whole = trimesh.Trimesh(drawn.vertices, drawn.faces, process=False)
    area = sum(trimesh.Trimesh(s.vertices, s.faces, process=False).area for s in scene.solids)
    assert whole.area == pytest.approx(area, rel=1e-9)


def test_reference_parents(scene: ScanScene) -> None:
    drawn = drawn_mesh(scene, 0.002)
    rows = np.arange(len(drawn.faces))
    inside = np.random.Generator(np.random.Philox(0)).dirichlet(np.ones(3), len(rows))
    solid, face, weights = drawn.parent(rows, inside)
    points = np.einsum("nk,nkj->nj", inside, drawn.vertices[drawn.faces])
    for k, own in enumerate(scene.solids):
        at = solid == k
        corners = own.vertices[own.faces[face[at]]]
        assert np.abs(np.einsum("nk,nkj->nj", weights[at], corners) - points[at]).max() < 1e-12


def test_properties_moves_with_its_solids(scene: ScanScene) -> None:
    drawn = drawn_mesh(scene, 0.002)
    moved = drawn.at(0.01) - drawn.vertices
    ball_rows = len(drawn.parts[0].source)
    assert np.allclose(moved[:ball_rows], [0.001, 0, 0])
    assert not moved[ball_rows:].any()
