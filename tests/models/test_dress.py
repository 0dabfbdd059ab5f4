"""What bodies wear and hold: eyes, lashes, teeth, tongue, garment."""

from __future__ import annotations

from typing import Any

import igl
import numpy as np
import pytest

from synthgen.cc0.body_poses import known_poses
from synthgen.cc0.skeleton import SMPLH52, SUPR75
from synthgen.errors import ModelError
from synthgen.geometry.normals import vertex_normals
from synthgen.models import BodyModel, load
from synthgen.models.dress import Attachment, attachments_of, dressed, read_attachments
from synthgen.sampling.streams import stream


@pytest.fixture(scope="module", params=["cc0-body", "cc0-supr"])
def body(request: pytest.FixtureRequest) -> BodyModel:
    return load(request.param)


def named(model: BodyModel) -> dict[str, Attachment]:
    return {a.name: a for a in attachments_of(model)}


def known(model: BodyModel) -> tuple[tuple[str, ...], Any]:
    return known_poses({"smplh": SMPLH52, "supr": SUPR75}[model.family])


def inside(points: Any, model: BodyModel, body_points: Any) -> Any:
    skin = np.asarray(body_points, dtype=np.float64)
    found = igl.fast_winding_number(skin, model.faces, np.asarray(points, dtype=np.float64))
    return found > 0.5


def test_smoke_everything_is_there(body: BodyModel) -> None:
    found = named(body)
    assert set(found) == {"eyes", "lashes", "teeth", "tongue", "garment"}
    for attachment in found.values():
        np.testing.assert_allclose(attachment.weights.sum(axis=1), 1, atol=1e-9)
        assert attachment.faces.max() < len(attachment.template)
        assert len(attachment.colour) == len(attachment.faces)
        assert attachment.shapedirs.shape == (len(attachment.template), 3, body.n_shape)


def test_shape_batch(body: BodyModel) -> None:
    poses = np.zeros((3, len(body.parents), 3))
    result = dressed(body, attachments_of(body), np.zeros((3, 2)), poses, np.ones((3, 3)))
    for attachment in attachments_of(body):
        points = result[attachment.name]
        assert points.dtype == np.float32
        np.testing.assert_allclose(
            points, attachment.template[None] + np.ones((3, 1, 3)), atol=1e-6
        )


def test_properties_garment_outside_in_known_poses(body: BodyModel) -> None:
    """No skin pokes through the cloth; what a crease swallows lies where the skin overlaps."""
    garment = named(body)["garment"]
    names, poses = known(body)
    shape = np.zeros((len(poses), 1))
    skin = body.evaluate(shape, poses).vertices.astype(np.float64)
    cloth = dressed(body, [garment], shape, poses)["garment"]
    assert garment.skin_ids is not None
    for name, own, around in zip(names, skin, cloth, strict=True):
        at = garment.skin_ids
        foot = np.einsum("nk,nkc->nc", garment.skin_shares, own[at])
        normal = np.einsum("nk,nkc->nc", garment.skin_shares, vertex_normals(own, body.faces)[at])
        assert np.sum((around - foot) * normal, axis=1).min() > 0, name
        overlapped = inside(foot + 5e-4 * normal, body, own)
        hidden = inside(around, body, own)
        assert (hidden & ~overlapped).mean() < 0.003, name
        assert hidden.mean() < {"sitting": 0.03, "squat": 0.08}.get(name, 0.002), name


def test_properties_garment_outside_for_any_shape(body: BodyModel) -> None:
    garment = named(body)["garment"]
    rng = stream(7, "sample", 0, 0, "dress")
    shape = rng.normal(size=(4, body.n_shape))
    poses = np.repeat(known(body)[1][:1], 4, axis=0)  # arms down
    skin = body.evaluate(shape, poses).vertices
    cloth = dressed(body, [garment], shape, poses)["garment"]
    for own, around in zip(skin, cloth, strict=True):
        assert inside(around, body, own).mean() < 0.005


def test_properties_garment_covers(body: BodyModel) -> None:
    """Torso, hips and shoulders lie under the cloth, head, hands and feet do not."""
    garment = named(body)["garment"]
    at = dict(zip(body.joint_names, body.shaped(np.zeros(1))[1], strict=True))
    low, high = garment.template.min(axis=0), garment.template.max(axis=0)
    assert low[1] < at["left_hip"][1] - 0.1
    assert at["left_knee"][1] < low[1]
    assert at["spine3"][1] < high[1] < at["head"][1]
    assert at["left_shoulder"][0] < high[0] < at["left_elbow"][0]


def test_properties_eyes_sit_in_their_sockets(body: BodyModel) -> None:
    eyes = named(body)["eyes"]
    for side, sign in (("left", 1), ("right", -1)):
        own = eyes.template[eyes.template[:, 0] * sign > 0]
        centre = 0.5 * (own.min(axis=0) + own.max(axis=0))
        radius = np.linalg.norm(own - centre, axis=1)
        assert 0.010 < radius.mean() < 0.016
        assert np.ptp(radius) < 0.002
        lids = body.v_template[np.linalg.norm(body.v_template - centre, axis=1) < 0.02]
        gap = own[:, 2].max() - lids[:, 2].max()
        assert -0.008 < gap < 0.004  # neither sunken nor bulging
        if body.family == "supr":
            joint = body.shaped(np.zeros(1))[1][body.joint_names.index(f"{side}_eye")]
            assert np.linalg.norm(joint - centre) < 0.003


def test_properties_eyes_turn_with_their_joint() -> None:
    body = load("cc0-supr")
    eyes = named(body)["eyes"]
    pose = np.zeros((1, 75, 3))
    pose[0, body.joint_names.index("left_eye"), 1] = 0.4
    moved = dressed(body, [eyes], np.zeros((1, 1)), pose)["eyes"][0] - eyes.template
    left = eyes.template[:, 0] > 0
    assert np.abs(moved[~left]).max() < 1e-6
    front = np.flatnonzero(left)[eyes.template[left, 2].argmax()]
    assert moved[front, 0] > 0.003  # looks to the subject's left


def test_properties_lashes_follow_a_blink() -> None:
    from synthgen.models.shipped import shipped_extras

    body, extras = load("cc0-supr"), shipped_extras("cc0-supr")
    names = extras["expression_unit_names"].tolist()
    blink = extras["expression_units"][names.index("eyeBlinkLeft")][None]
    lashes = named(body)["lashes"]
    closed = dressed(body, [lashes], np.zeros((1, 1)), np.zeros((1, 75, 3)), None, blink)
    moved = closed["lashes"][0] - lashes.template
    left = lashes.template[:, 0] > 0
    assert moved[left, 1].min() < -0.004
    assert np.abs(moved[~left]).max() < 2e-3


def test_edge_without_attachments(body: BodyModel) -> None:
    assert read_attachments(body, {}) == ()
    with pytest.raises(ModelError, match="hat"):
        read_attachments(body, {"attachments": np.array(["hat"])})
    assert attachments_of(load("cc0-hand")) == ()


MESH = {
    "attachments": np.array(["hat"]), "hat_template": np.zeros((3, 3)),
    "hat_shapedirs": np.zeros((3, 3, 2)), "hat_f": np.array([[0, 1, 2]]),
    "hat_weights_joint": np.zeros((3, 1)), "hat_weights_value": np.ones((3, 1)),
    "hat_colour": np.zeros((1, 3)),
}  # fmt: skip


def test_smoke_a_mesh_of_its_own(body: BodyModel) -> None:
    assert [made.name for made in read_attachments(body, MESH)] == ["hat"]


@pytest.mark.parametrize(("change", "words"), [
    ({"hat_f": np.array([[0, 1, 3]])}, "beyond its 3"),
    ({"hat_template": np.zeros((4, 3))}, "different lengths"),
    ({"hat_template": np.full((3, 3), np.nan)}, "NaN"),
    ({"hat_weights_joint": np.full((3, 1), 999)}, "do not fit"),
    ({"hat_bind_ids": np.full((3, 3), -1), "hat_bind_weights": np.ones((3, 3))}, "negative"),
    ({"hat_bind_ids": np.zeros((3, 3)), "hat_bind_weights": np.zeros((3, 3))}, "sum to 0"),
    ({"hat_bind_ids": np.full((3, 3), 10**7), "hat_bind_weights": np.ones((3, 3))}, "do not fit"),
    ({"attachments": np.float64(3)}, "do not fit"),
])  # fmt: skip
def test_edge_a_mesh_that_does_not_fit(body: BodyModel, change: dict[str, Any], words: str) -> None:
    with pytest.raises(ModelError, match=words):
        read_attachments(body, MESH | change)
