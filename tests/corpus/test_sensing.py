"""Sensor depth in a corpus: stored, read back, near the exact depth, absent where not asked for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import synthgen
from synthgen.config import load_config
from synthgen.corpus.runner import generate
from synthgen.corpus.sensing import scene_before
from synthgen.corpus.show import describe
from synthgen.sampling.draw import draw_sample

SMALL = ["samples=2", "render.width=96", "render.height=96", "render.spp=1",
         "camera.fov_deg=[28, 40]",
         "background.plain=1", "background.procedural=0", "background.room=0"]  # fmt: skip


@pytest.mark.parametrize("level", ["full", "half", "model"])
def test_smoke_corpus(level: str, tmp_path: Path) -> None:
    config = load_config("hand_rgbd", [*SMALL, f"render.sensor_depth={level}"])
    generate(config, tmp_path / "c", progress=False)
    corpus = synthgen.open_corpus(tmp_path / "c")
    for sample in corpus:
        view = sample.views[0]
        sensed, exact = view.sensor_depth_z_m, view.depth_z_m
        assert sensed is not None
        assert sensed.shape == exact.shape
        assert view.meta["sensor_depth"]["level"] == level
        hand = (view.instance_id == 1) & (sensed > 0)
        assert hand.sum() > 0.4 * (view.instance_id == 1).sum()
        error = np.abs(sensed - exact)[hand]
        assert np.median(error) < 0.01
        assert np.median(error) > 1e-5  # it is a sensor, not the truth
        again = synthgen.open_corpus(tmp_path / "c")[sample.index].views[0].sensor_depth_z_m
        assert np.array_equal(sensed, again)
    shown = describe(tmp_path / "c", 0, remake=True)
    assert shown["remake"] == {"same": True, "differing": []}
    assert cv2.imread(shown["pictures"][0]).shape == (96, 5 * 96, 3)


def test_smoke_none_where_not_asked_for(tmp_path: Path) -> None:
    generate(load_config("hand_rgbd", [*SMALL, "samples=1"]), tmp_path / "c", progress=False)
    assert synthgen.open_corpus(tmp_path / "c")[0].views[0].sensor_depth_z_m is None


@pytest.mark.parametrize(
    ("kind", "solids"), [("empty", 1), ("plain", 2), ("room", 3), ("outdoor", 2)]
)
def test_properties_walls(kind: str, solids: int) -> None:
    kinds = ("plain", "procedural", "room", "empty", "outdoor")
    weights = [f"background.{k}={int(k == kind)}" for k in kinds]
    scene = scene_before(draw_sample(load_config("hand_rgbd", [*SMALL, *weights]), 0))
    assert len(scene.solids) == solids
    assert [solid.kind for solid in scene.solids] == ["subject"] + ["stand"] * (solids - 1)


def test_properties_skin_scatters_as_the_sample_says() -> None:
    spec = draw_sample(load_config("hand_rgbd", SMALL), 0)
    rough = spec.scene.subjects[0].skin.roughness
    assert scene_before(spec).solids[0].surface.roughness == rough


def test_properties_things_and_sleeves_are_there_and_empty_slots_are_not() -> None:
    furnished = ["render.quality=full", "things.support=1", "wear.sleeve=1", "background.room=1",
                 "background.plain=0", "background.outdoor=0"]  # fmt: skip
    spec = draw_sample(load_config("hand_rgbd", [*SMALL, *furnished]), 0)
    scene = scene_before(spec)
    assert len(scene.solids) >= 4
    for solid in scene.solids:
        assert len(np.unique(solid.faces)) == len(solid.vertices)
        assert solid.vertices[:, 1].min() > -10
    sleeve = [s for s in scene.solids[1:] if len(s.faces) > 1000]
    hand = scene.solids[0].vertices
    assert any(np.linalg.norm(s.vertices.mean(axis=0) - hand.mean(axis=0)) < 0.5 for s in sleeve)
