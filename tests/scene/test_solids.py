"""Things as meshes: closed, outward, of the size asked for, all of one topology."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.scene import Thing
from synthgen.scene.solids import SolidMesh, mesh_of

SIZE = (0.1, 0.2, 0.3)
SHAPES = ("box", "cylinder", "ball", "bottle", "bowl", "cone")


def thing(shape: str, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Thing:
    return Thing("furniture", shape, (1.0, 2.0, 3.0), turn, SIZE, (0.5,) * 3, (0.1,) * 3, 0.5, 1)  # type: ignore[arg-type]


def crosses(mesh: SolidMesh) -> np.ndarray:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a))


@pytest.mark.parametrize("shape", SHAPES)
def test_properties_closed_and_outward(shape: str) -> None:
    mesh = mesh_of(thing(shape))
    normal = crosses(mesh)
    np.testing.assert_allclose(normal.sum(axis=0), 0, atol=1e-12)  # a closed surface
    big = np.linalg.norm(normal, axis=1) > 1e-12
    outward = np.einsum("ni,ni->n", normal, mesh.normals[mesh.triangles].sum(axis=1))
    assert (outward[big] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-9)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), SIZE, rtol=0.02)
    assert (mesh.uv >= 0).all()
    assert (mesh.uv <= 1).all()


def test_reference_volumes() -> None:
    for shape, volume in (
        ("box", 6e-3),
        ("cylinder", np.pi / 4 * 6e-3),
        ("ball", np.pi / 6 * 6e-3),
    ):
        mesh = mesh_of(thing(shape))
        inside = np.einsum("ni,ni->", crosses(mesh), mesh.vertices[mesh.triangles[:, 0]]) / 6
        assert inside == pytest.approx(volume, rel=0.03), shape


def test_properties_turn_and_place() -> None:
    turn = (0.3, -0.5, 1.0)
    still, turned = mesh_of(thing("bottle")), mesh_of(thing("bottle", turn))
    centre = np.array([1.0, 2.0, 3.0])
    R = matrix_from_axis_angle(np.array(turn))
    np.testing.assert_allclose(
        turned.vertices - centre, (still.vertices - centre) @ R.T, atol=1e-12
    )


def test_properties_one_topology() -> None:
    turned = [mesh_of(thing(s)) for s in SHAPES[1:]]
    assert len({m.triangles.tobytes() for m in turned}) == 1
