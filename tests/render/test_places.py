"""Places, lens and objects rendered: labels right, lens in image and labels alike, bytes stable."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import cv2
import numpy as np
import pytest
import torch
from kornia.geometry.calibration import distort_points

from synthgen.config import load_config
from synthgen.errors import BackendError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import load
from synthgen.models.surface import pose_surface
from synthgen.render import backend, sky
from synthgen.render.radiance import Film
from synthgen.render.renderer import RenderedView, Renderer
from synthgen.sampling.draw import draw_sample
from synthgen.sampling.spec import SampleSpec
from synthgen.scene import Motion, Optics, Picture, Sky
from synthgen.scene.instances import objects_of

SIZE = 64
BARREL = (-0.25, 0.05, 0.004, -0.003, 0.0)


def spec(index: int, *overrides: str, preset: str = "hand_full") -> SampleSpec:
    small = [f"render.width={SIZE}", f"render.height={SIZE}", "render.spp=2", "render.denoise=none",
             "skin.detail=false", "skin.relief_m=0"]  # fmt: skip
    return draw_sample(load_config(preset, [*small, *overrides]), index)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer("llvm_ad_rgb")


def first(renderer: Renderer, s: SampleSpec) -> RenderedView:
    return renderer.render(s)[0]


ONLY = {
    "room": ["background.room=1000", "light.room=1000"],
    "outdoor": ["background.outdoor=1000"],
    "one lamp": ["background.procedural=1000", "light.lamp=1000"],
    "sky on a wall": ["background.plain=1000", "light.sky=1000"],
}


@pytest.mark.parametrize("place", list(ONLY))
def test_smoke_every_place(renderer: Renderer, place: str) -> None:
    view = first(renderer, spec(1, *ONLY[place]))
    assert view.image is not None
    assert view.linear is not None
    assert np.isfinite(view.linear).all()
    assert view.image.std() > 5
    assert view.labels.valid.mean() > (0.6 if place == "outdoor" else 0.999)


def test_properties_light_and_sensor_change_no_label(renderer: Renderer) -> None:
    wall = ["background.procedural=1000", "optics.motion=0"]
    views = [
        renderer.labels(spec(2, *wall, *more))[0].labels
        for more in (["light.sky=1000"], ["light.constant=1000"], ["sensor.full_well=[0,0]"])
    ]
    for other in views[1:]:
        for name in ("depth_z_m", "instance_id", "part_id", "normals", "uv", "face_id"):
            assert np.array_equal(getattr(views[0], name), getattr(other, name)), name


def test_reference_lens_agrees_with_opencv_and_kornia(renderer: Renderer) -> None:
    """Labels through the lens are the pinhole's labels, looked up where OpenCV undistorts to."""
    s = spec(0, "background.plain=1000", "optics.distortion=0", preset="hand_rgbd")
    straight = s.scene.cameras[0]
    bent = replace(straight, distortion=BARREL)
    pinhole = renderer.labels(s)[0]
    lens = renderer.labels(replace(s, scene=replace(s.scene, cameras=(bent,))))[0]
    K, d = straight.K, np.array(BARREL)
    points = pinhole.hands[0].keypoints_3d.astype(np.float64)
    wanted, _ = cv2.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, d)
    np.testing.assert_allclose(lens.hands[0].keypoints_2d, wanted[:, 0], atol=1e-3)
    dist = torch.tensor(np.array(BARREL))[None]
    kornia = distort_points(
        torch.tensor(pinhole.hands[0].keypoints_2d.astype(np.float64))[None], torch.tensor(K)[None],
        dist,
    )  # fmt: skip
    np.testing.assert_allclose(lens.hands[0].keypoints_2d, kornia[0].numpy(), atol=1e-3)
    v, u = np.mgrid[:SIZE, :SIZE].astype(np.float64)
    grid = np.stack([u.ravel(), v.ravel()], axis=1)
    exact = (cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
    seen = cv2.undistortPoints(grid[:, None], K, d, None, None, K, exact)[:, 0]
    inside = np.all((seen > 1) & (seen < SIZE - 2), axis=1)
    wall = (pinhole.labels.instance_id == 0).astype(np.uint8)
    column, row = np.clip(np.rint(seen).astype(int), 0, SIZE - 1).T
    flat = cv2.erode(wall, np.ones((3, 3)))[row, column] > 0
    both = inside & flat & (lens.labels.instance_id.ravel() == 0)
    assert both.sum() > 500
    looked = cv2.remap(
        pinhole.labels.depth_z_m, seen[:, 0].astype(np.float32).reshape(SIZE, SIZE),
        seen[:, 1].astype(np.float32).reshape(SIZE, SIZE), cv2.INTER_LINEAR,
    )  # fmt: skip
    np.testing.assert_allclose(lens.labels.depth_z_m.ravel()[both], looked.ravel()[both], rtol=1e-4)


def test_reference_picture_is_bent_as_the_labels_are(renderer: Renderer) -> None:
    """First-hit normals of the film, averaged over the pixel, against those of pixel centres."""
    s = spec(0, "background.plain=1000", preset="hand_rgbd")
    bent = replace(s.scene.cameras[0], distortion=BARREL)
    s = replace(s, scene=replace(s.scene, cameras=(bent,)))
    live, posed = renderer._upload(s)
    labels = renderer._label(live, posed, s)[0].labels
    film = Film(live, bent, Optics()).guides(32, 1)
    world = labels.normals @ bent.T[:3, :3].T
    wall = cv2.erode((labels.instance_id == 0).astype(np.uint8), np.ones((3, 3))) > 0
    np.testing.assert_allclose(film.normal[wall], world[wall], atol=1e-3)
    hand = cv2.erode((labels.instance_id == 1).astype(np.uint8), np.ones((3, 3))) > 0
    close = np.sum(film.normal[hand] * world[hand], axis=1)
    assert np.median(close) > 0.98
    moved = np.sum(np.roll(film.normal, 2, axis=1)[hand] * world[hand], axis=1)
    assert np.median(moved) < np.median(close)


def test_properties_off_centre_and_oblong_pixels(renderer: Renderer) -> None:
    s = spec(0, "background.plain=1000", preset="hand_rgbd")
    c = s.scene.cameras[0]
    odd = replace(c, cx=c.cx + 6.5, cy=c.cy - 3.25, fy=1.2 * c.fy)
    view = first(renderer, replace(s, scene=replace(s.scene, cameras=(odd,))))
    pixels = view.hands[0].keypoints_3d @ odd.K.T
    np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], view.hands[0].keypoints_2d, atol=1e-2)
    assert view.linear is not None


def test_properties_blur_of_depth_and_motion(renderer: Renderer) -> None:
    s = spec(3, "background.procedural=1000", "light.constant=1000", "optics.motion=0",
             "optics.defocus=0", "render.spp=64", "wear.sleeve=0", "things.occluder=0")  # fmt: skip
    sharp = first(renderer, s)
    camera = s.scene.cameras[0]
    hand = np.asarray(s.scene.background.centre_m)
    focus = float((hand - camera.position) @ camera.T[:3, 2])
    wide = replace(s, scene=replace(s.scene, optics=(Optics(0.02, focus),)))
    shift = tuple(0.03 * camera.T[:3, 0])
    moving = replace(s, scene=replace(s.scene, motion=Motion(tuple(hand), shift, (0.0,) * 3, 4)))
    assert sharp.linear is not None

    def contrast(view: RenderedView, mask: np.ndarray) -> float:
        assert view.linear is not None
        grey = np.log(view.linear.mean(axis=-1) + 1e-4)
        return float(np.abs(np.diff(grey, axis=1))[mask[:, 1:]].mean())

    own = sharp.labels.instance_id == 1
    edge = cv2.morphologyEx(own.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0
    blurred, moved = first(renderer, wide), first(renderer, moving)
    assert contrast(blurred, ~own) < 0.8 * contrast(sharp, ~own)
    assert contrast(moved, edge) < 0.8 * contrast(sharp, edge)
    for other in (blurred, moved):
        assert np.array_equal(other.labels.depth_z_m, sharp.labels.depth_z_m)
        assert np.array_equal(other.labels.instance_id, sharp.labels.instance_id)


def test_reference_a_moving_hand_is_drawn_about_its_labels(renderer: Renderer) -> None:
    """However paths fall on sub-frames, a blur of 13 pixels has its middle at the exposure's."""
    s = spec(3, "background.empty=1000", "light.constant=1000", "render.spp=5", preset="hand_rgbd")
    camera, hand = s.scene.cameras[0], s.scene.background.centre_m
    places = []
    for length in (0.0, 0.03):
        shift = tuple(length * camera.T[:3, 0])
        motion = Motion(hand, shift, (0.0,) * 3, 4)
        view = first(renderer, replace(s, scene=replace(s.scene, motion=motion)))
        assert view.linear is not None
        grey = view.linear.mean(axis=-1)
        around = float(np.median(grey[view.labels.instance_id == 0]))
        share = np.clip(1 - grey / around, 0, 1)
        places.append(float((share * np.arange(share.shape[1])).sum() / share.sum()))
    assert abs(places[1] - places[0]) < 0.3


def occluded() -> SampleSpec:
    for index in range(30):
        s = spec(index, "things.occluder=1", "wear.sleeve=1", "wear.ring=1", *ONLY["room"])
        if any(t.role == "occluder" for t in s.scene.things) and s.scene.subjects[0].bands:
            return s
    raise AssertionError("no occluder fits anywhere")


def test_properties_occluders_hide_and_are_labelled(renderer: Renderer) -> None:
    s = occluded()
    view = renderer.labels(s)[0]
    bare = replace(s, scene=replace(s.scene, things=tuple(
        t for t in s.scene.things if t.role != "occluder")))  # fmt: skip
    free = renderer.labels(bare)[0]
    objects = objects_of(s.scene)
    assert [o.part_id for o in objects] == [18, 19, 19]
    thing = objects[-1].instance_id
    mask = view.labels.instance_id == thing
    assert mask.sum() > 10
    assert (view.labels.part_id[mask] == 19).all()
    assert (view.labels.depth_z_m[mask] < free.labels.depth_z_m[mask]).all()
    same = view.labels.instance_id[~mask] == free.labels.instance_id[~mask]
    assert same.all()  # modal masks: nothing else moved
    sleeve = view.labels.instance_id == objects[0].instance_id
    assert sleeve.sum() > 10
    assert (view.labels.part_id[sleeve] == 18).all()
    before, after = free.hands[0].keypoints_state, view.hands[0].keypoints_state
    pixels = np.clip(np.rint(view.hands[0].keypoints_2d).astype(int), 0, SIZE - 1)
    behind = cv2.erode(mask.astype(np.uint8), np.ones((3, 3)))[pixels[:, 1], pixels[:, 0]] > 0
    assert (after[behind & (before > 0)] == 1).all()
    assert (after <= before)[before == 2].all()


def test_properties_full_compiles_nothing_after_its_first_samples(renderer: Renderer) -> None:
    """Both hands, and other structures loaded in between; told by hash, for a cache hides much."""
    room = [*ONLY["room"], "optics.motion=0.5", "optics.defocus=0.5", "model.hands=both"]
    known = kernels(renderer, range(14), room)
    assert kernels(renderer, range(1), [*ONLY["outdoor"], "light.sky=1", "light.room=0"]) - known
    assert kernels(renderer, range(14, 24), room) <= known


def kernels(renderer: Renderer, samples: range, settings: list[str]) -> set[str]:
    """Hashes of the kernels that rendering takes."""
    dr = backend.drjit()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for index in samples:
            renderer.render(spec(index, *settings))
        return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}


def test_properties_full_gives_the_same_bytes_again(renderer: Renderer) -> None:
    s = spec(4, "optics.motion=1", "optics.defocus=1", "things.occluder=1")
    one = first(renderer, s)
    first(renderer, spec(5))
    two = first(renderer, s)
    three = first(Renderer("llvm_ad_rgb"), s)
    for other in (two, three):
        assert np.array_equal(one.linear, other.linear)
        assert np.array_equal(one.image, other.image)


@pytest.mark.skipif(find_spec("mitsuba_oidn") is None, reason="the extra denoise is not installed")
def test_properties_denoised_is_better_and_its_bytes_are_stable(renderer: Renderer) -> None:
    s = spec(1, *ONLY["room"], "optics.motion=0", "optics.defocus=0", "render.diffusion=false")
    clean = first(renderer, replace(s, render=replace(s.render, spp=256))).linear
    raw = first(renderer, s).linear
    quiet = replace(s, render=replace(s.render, denoise="oidn"))
    done, again = first(renderer, quiet).linear, first(Renderer("llvm_ad_rgb"), quiet).linear
    assert np.array_equal(done, again)

    def error(image: np.ndarray) -> float:
        return float(np.sqrt(np.mean((np.log(image + 0.01) - np.log(clean + 0.01)) ** 2)))

    assert error(done) < 0.7 * error(raw)


def test_edge_denoiser_missing_is_an_error(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    s = spec(1)
    with pytest.raises(BackendError, match="pip install mitsuba-oidn"):
        renderer.render(replace(s, render=replace(s.render, denoise="oidn")))


def test_properties_auto_is_resolved_in_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config("hand_full")
    for there, wanted in ((object(), "oidn"), (None, "none")):
        monkeypatch.setattr("synthgen.sampling.draw.find_spec", lambda name, t=there: t)
        drawn = draw_sample(config, 0)
        assert drawn.render.denoise == drawn.factors["denoise"] == wanted


def test_properties_sky_is_calibrated() -> None:
    """The irradiance asked for, whatever the sun; and a sun that outshines its sky when clear."""
    backend.activate("llvm_ad_rgb")
    away, solid_angle = sky.directions()
    assert solid_angle.sum() == pytest.approx(4 * np.pi, rel=1e-4)
    sun = np.array([0.3, 0.6, -0.74])
    sun /= np.linalg.norm(sun)
    shares = {}
    for share in (1.0, 0.35, 0.01):
        light = sky.radiance_of(Sky(tuple(sun), 3.0, share, 3.0)).astype(np.float64)
        grey = light.mean(axis=-1) * solid_angle
        towards = (away * grey[..., None]).sum(axis=(0, 1))
        facing = towards / np.linalg.norm(towards)
        assert (grey * np.maximum(away @ facing, 0)).sum() == pytest.approx(3.0, rel=1e-3)
        near = away @ sun > np.cos(np.deg2rad(2))
        shares[share] = float(grey[near].sum() / grey[away[..., 1] > 0].sum())
    assert shares[1.0] > 0.5 > shares[0.35] > 0.15 > shares[0.01]


def test_reference_panoramas_turn_about_y(monkeypatch: pytest.MonkeyPatch) -> None:
    away, _ = sky.directions()
    shown = np.zeros((*away.shape[:2], 3), np.float32)
    shown[away @ np.array([0.6, 0.0, -0.8]) > 0.995] = 1
    monkeypatch.setattr(sky, "read_panorama", lambda picture: shown)
    file = Picture("/a.exr", "0" * 64, "CC0")
    for turn in (0.0, 0.5, 2.0, 5.0):
        light = sky.radiance_of(Sky((0.0, 1.0, 0.0), 3.0, 1.0, 3.0, turn, file)).mean(axis=-1)
        towards = (away * light[..., None]).sum(axis=(0, 1))
        wanted = matrix_from_axis_angle(np.array([0.0, turn, 0.0])) @ [0.6, 0.0, -0.8]
        assert towards @ wanted / np.linalg.norm(towards) > np.cos(np.deg2rad(0.6))


def test_properties_forearm_twists_along_its_length() -> None:
    """Rings turn evenly from nothing at the wrist to all at the elbow; none is wrung."""
    model = load("cc0-hand", hand="right")
    bones = model.surface.arm
    _, joints = model.shaped(np.zeros(10))
    axis = (bones.elbow - joints[0]) / np.linalg.norm(bones.elbow - joints[0])
    still, twisted = (
        pose_surface(model, np.zeros(10), np.zeros((16, 3)), np.zeros(3), t * axis,
                     np.zeros(3))[0][model.surface.n_hand_vertices :]
        for t in (0.0, 0.8)
    )  # fmt: skip
    along = (still - joints[0]) @ axis
    ray, moved = (p - joints[0] - np.outer((p - joints[0]) @ axis, axis) for p in (still, twisted))
    angle = np.arctan2(np.cross(ray, moved) @ axis, np.sum(ray * moved, axis=1))
    length = np.linalg.norm(bones.elbow - joints[0])
    np.testing.assert_allclose(angle, 0.8 * np.clip(along / length, 0, 1), atol=1e-4)
    np.testing.assert_allclose(
        np.linalg.norm(moved, axis=1), np.linalg.norm(ray, axis=1), rtol=2e-3
    )
