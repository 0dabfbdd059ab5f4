"""The drawn surface passes through the model and knows its faces."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.models import ManoModel, load, pose_surface
from synthgen.scene import from_json, to_json
from synthgen.scene.surface import DrawnSurface


@pytest.fixture(scope="module")
def hand() -> ManoModel:
    return load("cc0-hand")


def posed(hand: ManoModel) -> np.ndarray:
    pose = np.zeros((16, 3))
    pose[4:7] = 0.4 * np.asarray(hand.joint_axes)[4:7, 0]
    zero = np.zeros(3)
    return pose_surface(hand, np.ones(10), pose, zero, zero, zero)[0]


def test_properties_through_the_models_vertices(hand: ManoModel) -> None:
    drawn = DrawnSurface.for_model(hand)
    refined = drawn.refine(posed(hand))
    n = len(hand.v_template)
    np.testing.assert_allclose(refined[:n], posed(hand)[:n], atol=1e-7)


def test_properties_corner_hits_are_model_vertices(hand: ManoModel) -> None:
    """First child of a face, first corner: the face's own first vertex, in uv and part as well."""
    drawn = DrawnSurface.for_model(hand)
    prim = 16 * np.arange(len(hand.faces))
    face, inside = drawn.parent(prim, np.tile([1.0, 0, 0], (len(prim), 1)))
    np.testing.assert_array_equal(face, np.arange(len(hand.faces)))
    np.testing.assert_allclose(inside, np.tile([1.0, 0, 0], (len(prim), 1)), atol=1e-12)
    corners = drawn.refine(posed(hand))[drawn.refined_faces[prim, 0]]
    np.testing.assert_allclose(corners, posed(hand)[hand.faces[:, 0]], atol=1e-7)
    uv = hand.surface.uv[hand.surface.uv_faces[: len(hand.faces), 0]]
    np.testing.assert_allclose(drawn.texture(face, inside), uv, atol=1e-6)
    np.testing.assert_array_equal(
        drawn.part(face, inside), hand.surface.part_of_vertex[hand.faces[:, 0]]
    )


def test_properties_render_vertices_are_split_but_equal(hand: ManoModel) -> None:
    drawn = DrawnSurface.for_model(hand)
    vertices, normals = drawn.draw(posed(hand))
    unsplit = drawn.refine(posed(hand))[drawn.refined_faces].astype(np.float32)
    np.testing.assert_array_equal(vertices[drawn.triangles], unsplit)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)


def test_reference_scene_round_trip() -> None:
    from synthgen.config import load_config
    from synthgen.sampling.draw import draw_sample

    scene = draw_sample(load_config("fixtures"), 0).scene
    assert from_json(to_json(scene)) == scene
