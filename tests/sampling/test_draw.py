"""Whole samples: pure functions of (config, seed, index, attempt)."""

from __future__ import annotations

import json

import numpy as np
import pytest

from synthgen.config import Config, load_config
from synthgen.geometry.cameras import project
from synthgen.models import load
from synthgen.sampling.draw import _pose, draw_sample, surface_of
from synthgen.sampling.spec import SampleSpec
from synthgen.sampling.streams import stream


def config(*overrides: str) -> Config:
    return load_config("hand_rgbd", [*overrides])


def test_smoke_json_round_trip() -> None:
    spec = draw_sample(config(), 0)
    assert SampleSpec.from_json(json.loads(json.dumps(spec.to_json()))) == spec


def test_properties_pure_function() -> None:
    first = [draw_sample(config(), i) for i in (0, 1, 2)]
    again = [draw_sample(config(), i) for i in (2, 0, 1)]
    assert [again[1], again[2], again[0]] == first
    assert draw_sample(config(), 0, attempt=1) != first[0]
    assert draw_sample(config("seed=1"), 0) != first[0]


def test_properties_background_and_light_leave_the_rest_alone() -> None:
    one = draw_sample(config("background.plain=1", "background.room=0"), 4)
    two = draw_sample(config("background.plain=0", "background.room=1", "light.room=1"), 4)
    assert one.scene.subjects == two.scene.subjects
    assert one.scene.cameras == two.scene.cameras


def test_properties_pose_settings_leave_identity_alone() -> None:
    one, two = draw_sample(config(), 4), draw_sample(config("pose.gmm_share=0"), 4)
    assert one.scene.subjects[0].shape == two.scene.subjects[0].shape
    assert one.scene.subjects[0].skin == two.scene.subjects[0].skin


@pytest.mark.parametrize("lens", ["[25,60]", "[100,120]"])
def test_reference_fill_is_what_the_hand_spans(lens: str) -> None:
    """Also where a wide lens cannot come near enough for the fill that was drawn."""
    for index in range(4):
        spec = draw_sample(config(f"camera.fov_deg={lens}", "camera.fill=[0.8,1]"), index)
        (subject,), (camera,) = spec.scene.subjects, spec.scene.cameras
        model = load(subject.model, hand=subject.hand)
        surface = surface_of(model, subject)[: model.surface.n_hand_vertices]
        span = np.ptp(project(camera, surface)[0], axis=0).max() / min(camera.width, camera.height)
        assert spec.factors["fill"] == pytest.approx(span, abs=1e-4)


def test_properties_shares_of_poses_stand_whatever_is_rejected() -> None:
    """The mixture gets the share that was asked for, although uniform poses fail more often."""
    strict = config("pose.penetration_limit_m=0.0005", "pose.gmm_share=0.4")
    shape, sources = np.zeros(10), []
    for index in range(30):
        source = _pose(strict, shape, index, stream(0, "sample", index, 0, "pose"))[1]
        rng = stream(0, "sample", index, 0, "pose")
        assert source == ("gmm" if rng.random() < 0.4 else "uniform")
        sources.append(source)
    assert set(sources) == {"gmm", "uniform"}


def test_properties_subjects_keep_shape_and_skin() -> None:
    specs = [draw_sample(config("subjects.count=2"), i) for i in range(8)]
    by_subject: dict[int, set[tuple[object, object]]] = {}
    for spec in specs:
        subject = spec.scene.subjects[0]
        by_subject.setdefault(subject.subject_id, set()).add((subject.shape, subject.skin))
    assert set(by_subject) <= {0, 1}
    assert all(len(looks) == 1 for looks in by_subject.values())


@pytest.mark.parametrize("index", range(6))
def test_reference_hand_in_frame_and_arm_end_out(index: int) -> None:
    spec = draw_sample(config("camera.views=2"), index)
    subject = spec.scene.subjects[0]
    model = load(subject.model, hand=subject.hand)
    assert model.surface is not None
    surface = surface_of(model, subject)
    for camera in spec.scene.cameras:
        end, z = project(camera, surface[model.surface.arm.end_ids])
        limit = np.array([camera.width, camera.height]) - 0.5
        assert not np.any(np.all((end > -0.5) & (end < limit), axis=1) & (z > 0))
        hand, z = project(camera, surface[: model.surface.n_hand_vertices])
        assert np.all(z > 0.05)
        assert np.all((hand > -0.5) & (hand < limit), axis=1).mean() > 0.8


def test_properties_one_side_only() -> None:
    assert {draw_sample(config("model.hands=left"), i).scene.subjects[0].hand for i in (0, 1)} == {
        "left"
    }
