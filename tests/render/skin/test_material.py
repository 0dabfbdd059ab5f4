"""The material: what each quality fills, and the normals of relief."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.config import load_config
from synthgen.render import backend
from synthgen.render.renderer import RenderedView, Renderer
from synthgen.render.skin import material
from synthgen.sampling.draw import draw_sample
from synthgen.sampling.spec import SampleSpec

LIGHT = ("light.area=1", "light.room=0", "light.constant=0", "model.hands=right")


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer("llvm_ad_rgb")


def spec(index: int, *overrides: str) -> SampleSpec:
    small = ["render.width=96", "render.height=96", "render.spp=4", "skin.detail=true"]
    return draw_sample(load_config("hand_rgbd", [*small, *LIGHT, *overrides]), index)


def changed(spec: SampleSpec, **values: object) -> SampleSpec:
    (subject,) = spec.scene.subjects
    skin = replace(subject.skin, **values)  # type: ignore[arg-type]
    return replace(spec, scene=replace(spec.scene, subjects=(replace(subject, skin=skin),)))


def linear(view: RenderedView) -> np.ndarray:
    assert view.linear is not None
    return view.linear


def test_smoke_sizes() -> None:
    assert material.atlas_size("plain", 448) < material.atlas_size("full", 256)
    assert material.atlas_size("full", 256) == 1024
    assert material.atlas_size("full", 448) == 2048


def test_reference_bumped_normals_of_a_known_slope(renderer: Renderer) -> None:
    """A unit square of 1 m with height 0.1 u: its normal leans back by atan(0.1)."""
    mi, dr = backend.mitsuba(), backend.drjit()
    n = 64
    ramp = np.tile((np.arange(n, dtype=np.float32) + 0.5) / n * 0.1, (n, 1))[..., None]
    relief = mi.load_dict(
        {"type": "bitmap", "bitmap": mi.Bitmap(ramp), "raw": True, "wrap_mode": "clamp"}
    )
    plane = mi.load_dict(
        {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale([0.5, 0.5, 1.0])}
    )
    scene = mi.load_dict({"type": "scene", "plane": plane})
    where = mi.Point3f(mi.Float([-0.3, 0.0, 0.2]), mi.Float([0.1, -0.2, 0.3]), 1.0)
    hit = scene.ray_intersect(mi.Ray3f(where, mi.Vector3f(0, 0, -1)))
    normal = np.array(material.bumped_normal(mi, dr, hit, relief, hit.is_valid())).T
    wanted = np.array([-0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)
    np.testing.assert_allclose(normal.reshape(-1, 3), np.tile(wanted, (3, 1)), atol=2e-3)


def test_properties_detail_changes_the_picture_and_no_label(renderer: Renderer) -> None:
    (plain,), (full,) = renderer.render(spec(0, "skin.detail=false")), renderer.render(spec(0))
    hand = full.labels.instance_id > 0
    assert np.abs(linear(plain) - linear(full))[hand].mean() > 1e-3
    for name in ("depth_z_m", "normals", "part_id", "uv", "face_id"):
        np.testing.assert_array_equal(getattr(plain.labels, name), getattr(full.labels, name))


def test_properties_relief_moves_depth_within_its_bound(renderer: Renderer) -> None:
    (flat,), (raised,) = (renderer.labels(spec(1, f"skin.relief_m={r}")) for r in (0.0, 0.002))
    both = (flat.labels.instance_id > 0) & (flat.labels.face_id == raised.labels.face_id)
    moved = np.abs(flat.labels.depth_z_m - raised.labels.depth_z_m)[both]
    assert np.quantile(moved, 0.9) > 5e-5
    assert np.quantile(moved, 0.95) < 4 * 0.002  # at a slant a step is longer
    np.testing.assert_array_equal(flat.hands[0].keypoints_3d, raised.hands[0].keypoints_3d)


def test_properties_creases_follow_pose_and_person(renderer: Renderer) -> None:
    s = spec(2)
    with_creases, without = (linear(renderer.render(t)[0]) for t in (s, changed(s, creases=0.0)))
    assert np.abs(with_creases - without).max() > 1e-3


def test_properties_same_bytes_whatever_came_before(renderer: Renderer) -> None:
    first = linear(renderer.render(spec(3))[0])
    renderer.render(spec(4))
    np.testing.assert_array_equal(first, linear(renderer.render(spec(3))[0]))
    np.testing.assert_array_equal(first, linear(Renderer("llvm_ad_rgb").render(spec(3))[0]))


def test_properties_scenes_share_one_skin() -> None:
    """A scene's maps of skin are most of its memory: there is one set, whatever scenes there are.

    Sides and lights take turns, and every picture is as if it were the only one.
    """
    turns = [spec(3), spec(3, "model.hands=left"), spec(4, "light.area=0", "light.constant=1")]
    shared = Renderer("llvm_ad_rgb")
    for s in (*turns, *turns):
        alone = linear(Renderer("llvm_ad_rgb").render(s)[0])
        np.testing.assert_array_equal(linear(shared.render(s)[0]), alone)
    skins = {live.shape("hand0").bsdf() for live in shared._scenes.values()}
    assert len(shared._scenes) == 3
    assert len(skins) == 1


def test_properties_no_kernel_is_compiled_again(renderer: Renderer) -> None:
    dr = backend.drjit()
    for index in range(2):
        renderer.render(spec(index))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for index in range(2, 5):
            renderer.render(spec(index))
        history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert history
    assert not [k for k in history if not k["cache_hit"]]
