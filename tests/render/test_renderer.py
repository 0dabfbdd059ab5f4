"""Rendered labels against analytic scenes, kornia and the reference rasteriser; determinism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from kornia.geometry import depth_to_3d, depth_to_normals, project_points

from synthgen.config import load_config
from synthgen.errors import BackendError, RenderError
from synthgen.geometry.raster import rasterise
from synthgen.geometry.transforms import look_at
from synthgen.models import load
from synthgen.render import backend
from synthgen.render.renderer import RenderedView, Renderer
from synthgen.sampling.draw import draw_sample, surface_of
from synthgen.sampling.spec import SampleSpec
from synthgen.scene import Background
from synthgen.scene.surface import DrawnSurface

SIZE = 96


def spec(index: int = 0, *overrides: str) -> SampleSpec:
    small = [f"render.width={SIZE}", f"render.height={SIZE}", "render.spp=4"]
    return draw_sample(load_config("hand_rgbd", [*small, *overrides]), index)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer("llvm_ad_rgb")


def same(a: RenderedView, b: RenderedView) -> bool:
    fields = ("depth_z_m", "normals", "uv", "part_id", "instance_id", "face_id", "barycentric")
    return bool(
        all(np.array_equal(getattr(a.labels, f), getattr(b.labels, f)) for f in fields)
        and np.array_equal(a.linear, b.linear)
        and np.array_equal(a.hands[0].keypoints_2d, b.hands[0].keypoints_2d)
    )


def test_smoke_shapes(renderer: Renderer) -> None:
    (view,) = renderer.render(spec())
    assert view.image is not None
    assert view.image.shape == (SIZE, SIZE, 3)
    assert view.labels.valid.all()
    assert set(np.unique(view.labels.instance_id)) == {0, 1}
    assert view.image.std() > 5


def test_smoke_nothing_behind_the_hand(renderer: Renderer) -> None:
    """An empty background is depth 0 and invalid, lit by the surround, and changes no hand."""
    walled, empty = (
        renderer.render(spec(1, "light.room=0", f"background.{kind}=1", *others))[0]
        for kind, others in (
            ("plain", ("background.procedural=0", "background.room=0")),
            ("empty", ("background.plain=0", "background.procedural=0", "background.room=0")),
        )
    )
    off = empty.labels.instance_id == 0
    assert not empty.labels.valid[off].any()
    assert not empty.labels.depth_z_m[off].any()
    assert not empty.labels.normals[off].any()
    assert empty.linear is not None
    ordinary = np.median(empty.linear[off], axis=0)
    assert np.mean(np.abs(empty.linear[off] - ordinary).max(axis=1) < 1e-5) > 0.9
    assert np.array_equal(walled.labels.instance_id, empty.labels.instance_id)
    assert np.array_equal(walled.labels.depth_z_m[~off], empty.labels.depth_z_m[~off])


@pytest.mark.parametrize("near_clip", [0.01, 0.3])
def test_reference_slanted_plane(renderer: Renderer, near_clip: float) -> None:
    """A wall seen at a slant: depth, distance and normal by hand, at two near clips."""
    scene = spec().scene
    wall = Background("plain", (0.5,) * 3, (0.5,) * 3, 1, 0.4, scene.background.centre_m)
    first = replace(scene, background=wall)
    tilted = first.cameras[0].T.copy()
    tilted[:3, :3] = tilted[:3, :3] @ look_at(np.zeros(3), np.array([0.3, -0.2, 1.0]))[:3, :3]
    camera = replace(first.cameras[0], T_world_from_camera=tuple(map(tuple, tilted.tolist())))
    live, _ = renderer._upload(replace(spec(), scene=first))
    live._params["sensor.near_clip"] = near_clip
    live._params.update()
    from synthgen.render.labels import label_view

    labels = label_view(live, camera)
    live._params["sensor.near_clip"] = 0.01
    live._params.update()
    frame = first.cameras[0].T
    normal = frame[:3, 2]
    point = np.array(wall.centre_m) + wall.distance_m * normal
    K, R, o = camera.K, tilted[:3, :3], tilted[:3, 3]
    v, u = np.mgrid[:SIZE, :SIZE]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones((SIZE, SIZE))], -1)
    z = ((point - o) @ normal) / ((rays @ R.T) @ normal)
    wall_seen = (labels.instance_id == 0) & (z > 0)
    assert wall_seen.sum() > 500
    np.testing.assert_allclose(labels.depth_z_m[wall_seen], z[wall_seen], atol=1e-5)
    distance = z * np.linalg.norm(rays, axis=-1)
    np.testing.assert_allclose(labels.distance_m[wall_seen], distance[wall_seen], atol=1e-5)
    np.testing.assert_allclose(
        labels.normals[wall_seen], np.broadcast_to(-normal @ R, (wall_seen.sum(), 3)), atol=1e-5
    )


@pytest.mark.parametrize("index", range(4))
def test_reference_rasteriser_mask_and_depth(renderer: Renderer, index: int) -> None:
    s = spec(index, "background.plain=1", "background.room=0", "light.room=0", "light.area=0")
    (view,) = renderer.labels(s)
    subject, camera = s.scene.subjects[0], s.scene.cameras[0]
    drawn = DrawnSurface.for_model(load(subject.model, hand=subject.hand))
    vertices = drawn.refine(surface_of(load(subject.model, hand=subject.hand), subject))
    z = (vertices - camera.position) @ camera.T[:3, 2]
    faces = drawn.refined_faces[(z[drawn.refined_faces] > 0.01).all(axis=1)]
    face, _, depth = rasterise(vertices, faces, camera)
    mask = face >= 0
    edge = mask[:, 1:] != mask[:, :-1]
    assert np.sum(mask != (view.labels.instance_id == 1)) <= max(1, 0.001 * edge.sum())
    both = mask & (view.labels.instance_id == 1)
    error = np.abs(view.labels.depth_z_m - depth)[both]
    assert np.quantile(error, 0.995) < 1e-5


def test_reference_fingertips_reproject(renderer: Renderer) -> None:
    """Pixels near a visible fingertip hit skin near that vertex; 2D and 3D agree to 0.05 px."""
    found = 0
    for index in range(6):
        s = spec(index)
        (view,) = renderer.labels(s)
        hand, camera = view.hands[0], view.camera
        pixels = (hand.keypoints_3d @ camera.K.T)[:, :2] / hand.keypoints_3d[:, 2:]
        assert np.abs(pixels - hand.keypoints_2d).max() < 0.05
        for tip in (4, 8, 12, 16, 20):
            if hand.keypoints_state[tip] == 2:
                u, v = np.rint(hand.keypoints_2d[tip]).astype(int)
                u, v = np.clip([u, v], 0, SIZE - 1)
                if view.labels.instance_id[v, u] == 1:
                    found += 1
                    assert abs(view.labels.depth_z_m[v, u] - hand.keypoints_3d[tip, 2]) < 0.02
    assert found >= 5


def test_reference_kornia(renderer: Renderer) -> None:
    (view,) = renderer.labels(spec(1, "background.plain=1", "background.room=0"))
    K = torch.tensor(view.camera.K)[None]
    depth = torch.tensor(view.labels.depth_z_m.astype(np.float64))[None, None]
    cloud = depth_to_3d(depth, K, normalize_points=False)[0].permute(1, 2, 0).numpy()
    distance = np.linalg.norm(cloud, axis=-1)
    np.testing.assert_allclose(distance, view.labels.distance_m, rtol=1e-5)
    normals = -depth_to_normals(depth, K)[0].permute(1, 2, 0).numpy()
    flat = view.labels.instance_id == 0
    flat[:2], flat[-2:], flat[:, :2], flat[:, -2:] = False, False, False, False
    cosine = np.sum(normals * view.labels.normals, axis=-1)
    assert np.median(cosine[flat]) > 0.9999
    assert np.median(cosine[view.labels.instance_id == 1]) > 0.97
    points = torch.tensor(view.hands[0].keypoints_3d.astype(np.float64))
    pixels = project_points(points, K.expand(21, 3, 3)).numpy()
    np.testing.assert_allclose(pixels, view.hands[0].keypoints_2d, atol=0.05)


def test_properties_same_bytes_in_any_order(renderer: Renderer) -> None:
    (first,) = renderer.render(spec(0))
    renderer.render(spec(1))
    (again,) = renderer.render(spec(0))
    assert same(first, again)
    (fresh,) = Renderer("llvm_ad_rgb").render(spec(0))
    assert same(first, fresh)


def test_properties_no_kernel_is_compiled_again(renderer: Renderer) -> None:
    """After some samples of each structure, new poses, lights, cameras and skins reuse kernels."""
    dr = backend.drjit()
    light = ("light.area=1", "light.room=0", "light.constant=0")
    for index in range(3):
        renderer.render(spec(index, *light, "model.hands=right"))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for index in range(3, 6):
            renderer.render(spec(index, *light, "model.hands=right"))
        history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert history
    assert not [k for k in history if not k["cache_hit"]]


def test_properties_two_hands_have_their_own_ids(renderer: Renderer) -> None:
    s = spec(0, "model.hands=right")
    other = s.scene.subjects[0]
    moved = replace(
        other,
        translation_m=tuple(np.array(other.translation_m) + s.scene.cameras[0].T[:3, 0] * 0.06),
    )
    (view,) = renderer.labels(replace(s, scene=replace(s.scene, subjects=(other, moved))))
    assert {1, 2} <= set(np.unique(view.labels.instance_id))
    assert len(view.hands) == 2


def test_properties_occlusion_is_seen(renderer: Renderer) -> None:
    """A second hand right in front turns visible keypoints into occluded ones."""
    s = spec(2, "model.hands=right")
    (free,) = renderer.labels(s)
    camera, hand = s.scene.cameras[0], s.scene.subjects[0]
    towards = -0.05 * camera.T[:3, 2]
    front = replace(hand, translation_m=tuple(np.array(hand.translation_m) + towards))
    (covered,) = renderer.labels(replace(s, scene=replace(s.scene, subjects=(hand, front))))
    before = (free.hands[0].keypoints_state == 2).sum()
    assert (covered.hands[0].keypoints_state == 2).sum() < 0.6 * before


def test_edge_distortion_is_refused_not_ignored(renderer: Renderer) -> None:
    s = spec(0)
    bent = replace(s.scene.cameras[0], distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(RenderError, match="distortion"):
        renderer.render(replace(s, scene=replace(s.scene, cameras=(bent,))))


def test_edge_one_variant_per_process(renderer: Renderer) -> None:
    with pytest.raises(BackendError, match="one variant"):
        backend.activate("cuda_ad_rgb")
    with pytest.raises(BackendError, match="allowed"):
        backend.activate("scalar_rgb")
