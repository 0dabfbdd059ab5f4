"""Mirroring is exact and its own inverse: hands, poses, pose spaces, bodies of all families."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import body_files
import numpy as np
import pytest

from synthgen.errors import ModelError, ShapeError
from synthgen.models import (
    BodyModel,
    load,
    load_hand,
    mirror_model,
    mirror_pose,
    openpose21,
    pose_surface,
    symmetry_of,
)
from synthgen.sampling.streams import stream

M = np.array([-1.0, 1.0, 1.0])
FAMILIES = ["smplh", "supr", "supr296", "constrained", "star"]


def make(kind: str, folder: Path) -> BodyModel:
    content = body_files.body("supr" if kind in ("supr296", "constrained") else kind)
    if kind == "smplh":
        raw = body_files.raw_smplh(content) | body_files.hands()
        return load(body_files.write_python2(folder / "body.pkl", raw))
    if kind == "star":
        np.savez(folder / "body.npz", **content)
        return load(folder / "body.npz")
    if kind == "supr296":
        content["posedirs"] = content["posedirs"][:, :, 4:]
    meta = body_files.axis_meta(75, 20, 6) if kind == "constrained" else None
    return load(body_files.write_supr(folder / "body.npy", content, meta))


def draws(model: BodyModel, n: int = 3) -> tuple[Any, Any, Any]:
    rng = stream(0, "sample", 0, 0, "mirror")
    if model.axis_meta is not None:
        pose = rng.normal(0, 0.6, (n, model.axis_meta.n_pose))
    else:
        pose = rng.normal(0, 0.6, (n, len(model.parents), 3))
    return rng.normal(size=(n, model.n_shape)), pose, rng.normal(size=(n, 3))


def test_reference_left_is_the_mirrored_right() -> None:
    right, left = load_hand("cc0-hand", hand="right"), load_hand("cc0-hand", hand="left")
    shape, pose, move = draws(right)
    a, ja = right.evaluate_reference(shape, pose, move)
    b, jb = left.evaluate_reference(shape, mirror_pose(pose), move * M)
    np.testing.assert_allclose(b, a * M, atol=1e-12)
    np.testing.assert_allclose(jb, ja * M, atol=1e-12)
    np.testing.assert_array_equal(left.faces, right.faces[:, ::-1])


@pytest.mark.parametrize("kind", FAMILIES)
def test_reference_bodies(kind: str, tmp_path: Path) -> None:
    model = make(kind, tmp_path)
    other, pairs = mirror_model(model), symmetry_of(model)
    shape, pose, move = draws(model)
    a, ja = model.evaluate_reference(shape, pose, move)
    b, jb = other.evaluate_reference(shape, mirror_pose(pose, model), move * M)
    np.testing.assert_allclose(b, a[:, pairs.vertices] * M, atol=1e-12)
    np.testing.assert_allclose(jb, ja[:, pairs.joints] * M, atol=1e-12)
    assert np.abs(a).max() > 0.1


@pytest.mark.parametrize("kind", FAMILIES)
def test_properties_twice_is_the_identity(kind: str, tmp_path: Path) -> None:
    model = make(kind, tmp_path)
    again = mirror_model(mirror_model(model))
    for name in ("v_template", "shapedirs", "posedirs", "weights", "J_regressor", "faces",
                 "fingertip_ids", "landmark_ids"):  # fmt: skip
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    pose = draws(model)[1]
    np.testing.assert_array_equal(mirror_pose(mirror_pose(pose, model), model), pose)


def test_properties_hands_of_a_body_change_places(tmp_path: Path) -> None:
    model = make("smplh", tmp_path)
    other = mirror_model(model)
    turn = np.tile([1.0, -1, -1], 15)
    assert model.hands_right is not None
    assert other.hands_left is not None
    np.testing.assert_array_equal(other.hands_left.mean, model.hands_right.mean * turn)
    coefficients = np.array([0.4, -1.0, 2.0])
    a = coefficients @ model.hands_right.components[:3] + model.hands_right.mean
    b = coefficients @ other.hands_left.components[:3] + other.hands_left.mean
    np.testing.assert_allclose(b.reshape(15, 3), mirror_pose(a.reshape(15, 3)), atol=1e-12)


def test_properties_keypoints_of_a_mirrored_body(tmp_path: Path) -> None:
    model = make("smplh", tmp_path)
    shape, pose, move = draws(model)
    a = openpose21(model, model.evaluate(shape, pose, move), "right")
    other = mirror_model(model)
    b = openpose21(other, other.evaluate(shape, mirror_pose(pose, model), move * M), "left")
    np.testing.assert_allclose(b, a * M, atol=2e-6)


def test_properties_permutation_of_the_file_equals_that_by_geometry(tmp_path: Path) -> None:
    model = make("smplh", tmp_path)
    by_file = symmetry_of(model).vertices
    by_shape = symmetry_of(replace(model, vert_sym_idxs=None)).vertices
    np.testing.assert_array_equal(by_file, by_shape)
    assert (by_file != np.arange(len(by_file))).sum() == 120


def test_properties_arm_too() -> None:
    right, left = load_hand("cc0-hand", hand="right"), load_hand("cc0-hand", hand="left")
    pose = stream(0, "sample", 0, 0, "arm").normal(0, 0.4, (16, 3))
    wrist, elbow = np.array([0.2, 0.1, 0.3]), np.array([0.0, 1.0, 0.4])
    a, _ = pose_surface(right, np.ones(10), pose, np.zeros(3), wrist, elbow)
    b, _ = pose_surface(left, np.ones(10), mirror_pose(pose), np.zeros(3), mirror_pose(wrist),
                        mirror_pose(elbow))  # fmt: skip
    np.testing.assert_allclose(b, a * M, atol=1e-6)


def test_properties_hand_twice_is_the_identity() -> None:
    model = load_hand("cc0-hand", hand="right")
    again = mirror_model(mirror_model(model))
    for name in ("v_template", "shapedirs", "posedirs", "faces", "hands_mean", "hands_components"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    np.testing.assert_array_equal(again.surface.arm.template, model.surface.arm.template)
    assert again.hand == model.hand


def test_edge_bodies_that_do_not_pair_up(tmp_path: Path) -> None:
    model = replace(make("smplh", tmp_path), vert_sym_idxs=None)
    bent = model.v_template.copy()
    bent[3] += [0.0, 0.05, 0.0]
    with pytest.raises(ModelError, match=r"no mirror image|from mirror images"):
        mirror_model(replace(model, v_template=bent))
    with pytest.raises(ModelError, match="no mirror image"):
        mirror_model(model, vertices=np.roll(np.arange(len(bent)), 1))
    with pytest.raises(ModelError, match=r"vertex \d+ and its counterpart"):
        mirror_model(model, vertices=np.arange(len(bent)))
    names = tuple(n.replace("right_knee", "other_knee") for n in model.joint_names)
    with pytest.raises(ModelError, match="'right_knee'"):
        mirror_pose(np.zeros((52, 3)), replace(model, joint_names=names))
    with pytest.raises(ShapeError, match="52, 3"):
        mirror_pose(np.zeros((24, 3)), model)
    with pytest.raises(ShapeError, match=r"\.\.\., 3"):
        mirror_pose(np.zeros((16, 4)))
