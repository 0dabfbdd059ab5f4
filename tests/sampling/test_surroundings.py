"""Surroundings: each ingredient has a stream of its own and keeps clear of the subject."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from synthgen.config import load_config
from synthgen.errors import FileError
from synthgen.models import load
from synthgen.sampling.backgrounds import sample_background
from synthgen.sampling.draw import draw_sample, surface_of
from synthgen.sampling.lighting import room_box, sample_lights
from synthgen.sampling.spec import SampleSpec
from synthgen.sampling.stage import Stage
from synthgen.sampling.streams import stream
from synthgen.sampling.things import MOST_BOXES, MOST_TURNED
from synthgen.scene import Scene
from synthgen.scene.solids import mesh_of

FULL = ["render.denoise=none"]


def draw(index: int, *settings: str) -> SampleSpec:
    return draw_sample(load_config("hand_full", [*FULL, *settings]), index)


def test_smoke_same_again_and_through_json() -> None:
    for index in range(6):
        spec = draw(index)
        assert spec == draw(index)
        assert SampleSpec.from_json(json.loads(json.dumps(spec.to_json()))) == spec


# What each switch may change; all else of the scene must stay.
SWITCHES = {
    "light.lamp=1000": {"lights"},
    "sensor.full_well=[0,0]": {"sensor"},
    "sensor.exposure_ev=0": {"sensor"},
    "optics.defocus=0": {"optics"},
    "optics.motion=1": {"motion"},
    "things.occluder=1": {"things"},
    "things.furniture=0": {"things"},
    "optics.distortion=0": {"cameras"},
    "background.plain=1000": {"background", "things", "lights"},
    "skin.tones=[0.9,1]": {"subjects"},
}


@pytest.mark.parametrize("setting", list(SWITCHES))
def test_properties_switching_one_leaves_the_rest(setting: str) -> None:
    changed = set()
    for index in range(5):
        before, after = draw(index).scene, draw(index, setting).scene
        changed |= {
            f for f in Scene.__dataclass_fields__ if getattr(before, f) != getattr(after, f)
        }
    assert changed
    assert changed <= SWITCHES[setting]


def test_properties_what_is_worn_changes_no_pose_and_no_skin() -> None:
    bare, dressed = draw(3, "wear.sleeve=0"), draw(3, "wear.sleeve=1", "wear.ring=1")
    a, b = bare.scene.subjects[0], dressed.scene.subjects[0]
    assert b.sleeve is not None
    assert replace(b, sleeve=None, bands=a.bands) == a
    assert bare.scene.cameras == dressed.scene.cameras


def test_properties_things_keep_clear() -> None:
    seen = set()
    for index in range(24):
        spec = draw(index, "things.support=1", "things.occluder=1")
        subject = spec.scene.subjects[0]
        cameras = tuple(replace(c, distortion=(0.0,) * 5) for c in spec.scene.cameras)
        model = load(subject.model, hand=subject.hand)
        surface = surface_of(model, subject)
        stage = Stage(surface, model.surface.n_hand_vertices, cameras, np.zeros((0, 3)))
        for thing in spec.scene.things:
            seen.add(thing.role)
            if thing.role == "support":
                top = thing.position_m[1] + thing.size_m[1] / 2
                low = stage.in_frame(0.0)[:, 1].min()
                assert -0.001 < low - top < 0.15
                assert all(camera.position[1] > top for camera in cameras)
            else:
                points = mesh_of(thing).vertices
                centre, half = points.mean(axis=0), np.ptp(points, axis=0).max()
                assert not np.any(np.linalg.norm(surface - centre, axis=1) < 0.1 * half)
        boxes = sum(t.shape == "box" for t in spec.scene.things)
        assert boxes <= MOST_BOXES + 1
        assert len(spec.scene.things) - boxes <= MOST_TURNED
    assert seen == {"support", "occluder", "furniture"}


def test_properties_rooms_hold_cameras_lamps_and_hand() -> None:
    rooms = 0
    for index in range(24):
        scene = draw(index).scene
        if scene.background.kind != "room":
            continue
        rooms += 1
        low, high = room_box(scene.background)
        inside = [c.position for c in scene.cameras]
        inside += [np.array(lamp.position_m) for lamp in scene.lights.area]
        inside.append(np.array(scene.background.centre_m))
        assert all((p > low - 1e-3).all() and (p < high + 1e-3).all() for p in inside)
        assert scene.lights.area
        assert scene.lights.sky is None
    assert rooms > 5


def test_properties_walls_stand_behind_hand_and_arm() -> None:
    """Also of a hand at the edge of a wide picture, which is nearer along the axis than it is."""
    only = ["background.procedural=1000", "camera.offset=0.5", "camera.fov_deg=[100,120]"]
    for index in range(30):
        scene = draw(index, *only).scene
        wall, camera, subject = scene.background, scene.cameras[0], scene.subjects[0]
        surface = surface_of(load(subject.model, hand=subject.hand), subject)
        behind = (surface - np.array(wall.centre_m)) @ camera.T[:3, 2]
        assert behind.max() < wall.distance_m


@pytest.mark.parametrize("kind", ["lamp", "room"])
@pytest.mark.parametrize("height", [0.15, 0.6])
def test_properties_lamps_hang_inside_the_room(kind: str, height: float) -> None:
    """Also where the camera is straight above: a lamp behind a wall leaves the picture black."""
    hand = np.array([0.1, 1.35, 0.0])
    eye = hand + [0.01, height, 0.0]
    for index in range(100):
        rng = stream(7, "sample", index, 0, "light")
        room = sample_background("room", hand, 0.2, eye[None], rng=rng)
        low, high = room_box(room)
        for lamp in sample_lights(kind, hand, eye, room, rng=rng).area:
            place = np.array(lamp.position_m)
            assert (place > low).all()
            assert (place < high).all()


def test_properties_files_are_recorded_with_their_licence(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((40, 40, 3), np.uint8))
    only = ["background.photo=1"] + [
        f"background.{k}=0" for k in ("plain", "procedural", "room", "outdoor")
    ]
    spec = draw(0, *only, f"files.images={tmp_path}", "files.licence=CC0")
    assert spec.scene.background.file is not None
    assert spec.scene.background.file.licence == "CC0"
    assert len(spec.scene.background.file.sha256) == 64
    assert spec.factors["licence"] == "CC0"
    with pytest.raises(FileError, match="neither a file nor a folder"):
        draw(0, *only, "files.images=/nowhere/at/all", "files.licence=CC0")
