"""Parts of bodies: exactly the body's rows, closed under ancestors, and writable."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import body_files
import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.models import BodyModel, load, openpose21, separate
from synthgen.models.parts import PARTS, influences, part_vertices
from synthgen.sampling.streams import stream


def supr(folder: Path, *, expression: int = 5, constrained: bool = False) -> BodyModel:
    """A SUPR body whose correctives act near their joints only, with expressions."""
    content = body_files.body("supr", pairs=300)
    rng = stream(0, "sample", 0, 0, "activation")
    near = content["weights"] > 0
    near |= rng.random(near.shape) < 0.002
    content["posedirs"] = content["posedirs"] * np.repeat(near, 4, axis=1)[:, None]
    meta = body_files.axis_meta(75, 20, 6) if constrained else None
    model = load(body_files.write_supr(folder / "supr.npy", content, meta))
    v = len(model.v_template)
    return replace(model, exprdirs=rng.normal(0, 0.01, (v, 3, expression)))


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("constrained", [False, True])
def test_reference_part_has_the_rows_of_the_body(
    part: str, constrained: bool, tmp_path: Path
) -> None:
    body = supr(tmp_path, constrained=constrained)
    cut = separate(body, part)
    rng = stream(1, "sample", 0, 0, "parts")
    shape, move = rng.normal(size=(3, body.n_shape)), rng.normal(size=(3, 3))
    expression = rng.normal(size=(3, 5))
    if constrained:
        pose = rng.normal(0, 0.5, (3, body.axis_meta.n_pose))
        own = pose[:, cut.pose_columns]
    else:
        pose = rng.normal(0, 0.5, (3, 75, 3))
        own = pose[:, cut.joint_ids]
    whole, joints = body.evaluate_reference(shape, pose, move, expression)
    mine, at = cut.model.evaluate_reference(shape, own, move, expression)
    np.testing.assert_allclose(mine, whole[:, cut.vertex_ids], atol=1e-14, rtol=0)
    np.testing.assert_allclose(at, joints[:, cut.joint_ids], atol=1e-14, rtol=0)
    single = body.evaluate(shape, pose, move, expression).vertices[:, cut.vertex_ids]
    np.testing.assert_allclose(
        cut.model.evaluate(shape, own, move, expression).vertices, single, atol=1e-6
    )
    assert len(cut.joint_ids) < 75


def test_reference_equation_4_by_loops(tmp_path: Path) -> None:
    body = supr(tmp_path)
    vertices = part_vertices(body, "left_hand")
    expected = set()
    for j in range(75):
        skinned = any(body.weights[v, j] != 0 for v in vertices)
        corrected = any((body.posedirs[v, :, 4 * j : 4 * j + 4] != 0).any() for v in vertices)
        while (skinned or corrected) and j >= 0:
            expected.add(j)
            j = int(body.parents[j])
    assert set(influences(body, vertices).tolist()) == expected


def test_properties_ancestors_that_influence_nothing_are_kept(tmp_path: Path) -> None:
    body = supr(tmp_path)
    k, v = 75, len(body.v_template)
    weights = np.zeros((v, k))
    weights[:, body.joint_names.index("left_wrist")] = 1
    lone = replace(body, weights=weights, posedirs=np.zeros_like(body.posedirs))
    cut = separate(lone, np.arange(10))
    expected = {"pelvis", "spine1", "spine2", "spine3", "left_collar", "left_shoulder",
                "left_elbow", "left_wrist"}  # fmt: skip
    assert set(cut.model.joint_names) == expected
    assert cut.model.parents.tolist() == [-1, 0, 1, 2, 3, 4, 5, 6]


def test_properties_regressor_of_the_part_alone_gives_the_same_joints(tmp_path: Path) -> None:
    cut = separate(supr(tmp_path), "right_foot").model
    rng = stream(2, "sample", 0, 0, "parts")
    shape, psi = rng.normal(size=cut.n_shape), rng.normal(size=5)
    own = replace(cut, joint_basis=None)
    np.testing.assert_allclose(own.shaped(shape, psi)[1], cut.shaped(shape, psi)[1], atol=1e-9)


@pytest.mark.parametrize("family", ["smplh", "star"])
def test_properties_other_families(family: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "body.npz", **body_files.body(family, pairs=200))
    body = load(tmp_path / "body.npz")
    cut = separate(body, "right_hand")
    rng = stream(3, "sample", 0, 0, "parts")
    shape, pose = rng.normal(size=(2, 12)), rng.normal(0, 0.4, (2, len(body.parents), 3))
    whole, _ = body.evaluate_reference(shape, pose)
    mine, _ = cut.model.evaluate_reference(shape, pose[:, cut.joint_ids])
    np.testing.assert_allclose(mine, whole[:, cut.vertex_ids], atol=1e-14, rtol=0)


def test_properties_keypoints_of_a_separated_hand(tmp_path: Path) -> None:
    body = supr(tmp_path)
    cut = separate(body, "left_hand")
    pose = stream(4, "sample", 0, 0, "parts").normal(0, 0.4, (1, 75, 3))
    shape = np.zeros((1, 1))
    whole = openpose21(body, body.evaluate(shape, pose), "left")
    mine = openpose21(cut.model, cut.model.evaluate(shape, pose[:, cut.joint_ids]), "left")
    np.testing.assert_allclose(mine, whole, atol=1e-6)


def test_edge_unknown_parts(tmp_path: Path) -> None:
    body = supr(tmp_path)
    with pytest.raises(ModelError, match="did you mean 'left_hand'"):
        separate(body, "left_hnd")
    with pytest.raises(ModelError, match="vertices 0 to 607"):
        separate(body, np.array([0, 608]))
    with pytest.raises(ModelError, match="no vertices of a head"):
        separate(separate(body, "left_foot").model, "head")
