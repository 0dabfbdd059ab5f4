"""Feet on the ground: contact, network, deformation."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from synthgen.errors import ModelError, ShapeError
from synthgen.models import BodyModel, Posed, load
from synthgen.models.foot import (
    SIZES,
    FootNetwork,
    deform_feet,
    feet_of,
    read_feet,
    touching,
)
from synthgen.models.shipped import shipped_extras
from synthgen.sampling.streams import stream

SHAPE, POSE = np.zeros((1, 30)), np.zeros((1, 75, 3))


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load("cc0-supr")


@pytest.fixture(scope="module")
def feet(body: BodyModel) -> tuple[FootNetwork, FootNetwork]:
    return feet_of(body)


@pytest.fixture(scope="module")
def standing(body: BodyModel) -> Posed:
    return body.evaluate(SHAPE, POSE)


def test_smoke_presses_the_sole_flat(
    body: BodyModel, feet: tuple[FootNetwork, FootNetwork], standing: Posed
) -> None:
    """Standing 4 mm too deep, at least half of the depth under the ground goes away."""
    for depth in (0.002, 0.004, 0.006):
        ground = (0.0, 1.0, 0.0, float(standing.vertices[0, :, 1].min()) + depth)
        pressed = deform_feet(
            feet, standing.vertices, standing.transforms, body.weights, SHAPE, POSE, ground
        )
        before, after = (
            np.maximum(ground[3] - v[0, :, 1], 0).sum() for v in (standing.vertices, pressed)
        )
        assert after < 0.5 * before


def test_shape_of_the_network(feet: tuple[FootNetwork, FootNetwork]) -> None:
    for foot in feet:
        assert tuple(m.shape[1] for m in foot.matrices) == SIZES[:-1]
        assert foot.matrices[-1].shape[0] == 798
        assert len(foot.joint_ids) == 13
        assert len(foot.point_ids) == 266
        assert np.isin(foot.point_ids, foot.vertex_ids).all()
        contact = np.zeros((3, 266), dtype=bool)
        feature = foot.feature(np.zeros((3, 30)), np.zeros((3, 75, 3)), contact)
        assert feature.shape == (3, 320)
        assert np.all(feature == 0)  # rest pose, mean shape, no contact
        assert foot.forward(feature).shape == (3, 266, 3)


def test_properties_measured_gain(body: BodyModel) -> None:
    said = json.loads(body.provenance)["feet_unseen"]
    assert said["with_mm"] < 0.5 * said["without_mm"]
    assert said["not_touching_mm"] == 0


def test_properties_no_contact_no_change(
    body: BodyModel, feet: tuple[FootNetwork, FootNetwork], standing: Posed
) -> None:
    ground = (0.0, 1.0, 0.0, float(standing.vertices[0, :, 1].min()) - 0.001)
    same = deform_feet(
        feet, standing.vertices, standing.transforms, body.weights, SHAPE, POSE, ground
    )
    assert np.array_equal(same, standing.vertices)


def test_properties_only_feet_move_and_one_by_one(
    body: BodyModel, feet: tuple[FootNetwork, FootNetwork]
) -> None:
    """With the left leg lifted, only the right foot gives way."""
    pose = POSE.copy()
    pose[0, body.joint_names.index("left_knee"), 0] = 0.8
    posed = body.evaluate(SHAPE, pose)
    ground = (0.0, 1.0, 0.0, float(posed.vertices[0, :, 1].min()) + 0.004)
    pressed = deform_feet(feet, posed.vertices, posed.transforms, body.weights, SHAPE, pose, ground)
    moved = np.flatnonzero((pressed != posed.vertices).any(axis=(0, 2)))
    assert len(moved) > 50
    assert np.isin(moved, feet[1].vertex_ids).all()


def test_reference_left_mirrors_right(feet: tuple[FootNetwork, FootNetwork]) -> None:
    left, right = feet
    rng = stream(5, "sample", 0, 0, "feet")
    pose, shape = rng.normal(0, 0.3, (2, 75, 3)), rng.normal(size=(2, 30))
    contact = rng.random((2, 266)) < 0.3
    mirrored = pose.copy()
    mirrored[:, left.joint_ids] = pose[:, right.joint_ids] * [1, -1, -1]
    theirs = left.offsets(shape, mirrored, contact)
    np.testing.assert_allclose(theirs * [-1, 1, 1], right.offsets(shape, pose, contact), atol=1e-12)


def test_reference_forward_as_torch_computes_it(feet: tuple[FootNetwork, FootNetwork]) -> None:
    torch = pytest.importorskip("torch")
    foot = feet[1]
    rng = stream(6, "sample", 0, 0, "feet")
    x = rng.normal(size=(4, 320))
    y = torch.tensor(x)
    for k, (matrix, bias) in enumerate(zip(foot.matrices, foot.biases, strict=True)):
        y = torch.nn.functional.linear(y, torch.tensor(matrix), torch.tensor(bias))
        y = torch.nn.functional.leaky_relu(y, 0.1) if k < 8 else y
    np.testing.assert_allclose(foot.forward(x), y.numpy().reshape(4, 266, 3), atol=1e-12)


def test_properties_contact_threshold() -> None:
    heights = np.array([[0, 0.00009, 0], [0, 0.00011, 0], [0, -0.01, 0]])
    assert touching(heights).tolist() == [True, False, True]
    tilted = np.array([0.6, 0.8, 0.0])
    assert touching(tilted * 0.5, (0.6, 0.8, 0.0, 0.5)).all()
    assert not touching(tilted * 0.501, (0.6, 0.8, 0.0, 0.5)).any()


def test_edge_bad_input(feet: tuple[FootNetwork, FootNetwork]) -> None:
    with pytest.raises(ShapeError, match="320"):
        feet[0].forward(np.zeros((2, 319)))
    with pytest.raises(ModelError, match="cc0-supr"):
        feet_of(load("cc0-body"))
    with pytest.raises(ModelError, match="foot_matrix"):
        read_feet({f"foot_{what}_{k}": np.zeros((2, 2)) for what in ("matrix", "bias")
                   for k in range(9)})  # fmt: skip


@pytest.mark.parametrize(("change", "words"), [
    ({"foot_bias_3": None}, "lack 'foot_bias_3'"),
    ({"foot_bias_3": np.zeros(3)}, "foot_bias"),
    ({"foot_matrix_3": np.array("x")}, "do not fit together"),
    ({"foot_spread_row": np.full(1, 10**7)}, "do not fit together"),
])  # fmt: skip
def test_edge_arrays_that_do_not_fit(change: dict[str, Any], words: str) -> None:
    arrays = {k: v for k, v in (dict(shipped_extras("cc0-supr")) | change).items() if v is not None}
    with pytest.raises(ModelError, match=words):
        read_feet(arrays)


def test_edge_points_beyond_the_body(monkeypatch: pytest.MonkeyPatch) -> None:
    arrays = dict(shipped_extras("cc0-supr")) | {"foot_left_point_ids": np.full(266, 10**7)}
    monkeypatch.setattr("synthgen.models.foot.shipped_extras", lambda _: arrays)
    with pytest.raises(ModelError, match="left foot's network"):
        feet_of(load("cc0-supr"))
