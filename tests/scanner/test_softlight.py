"""Light kept at vertices: heat flow, one bounce against an analytic case, the shadow cache."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from synthgen.sampling.streams import stream
from synthgen.scanner import Effects, ScanScene, Surface, solid_from_mesh
from synthgen.scanner.diffusion import heat_flow
from synthgen.scanner.exposure import speckle_radiance
from synthgen.scanner.softlight import bounce, soft_light
from synthgen.scanner.stage import Stage, prepare
from tests.scanner.small import PLAIN, ball, ball_before_wall, mini, wall


def staged(scene: ScanScene, effects: Effects | None = None) -> Stage:
    rng = stream(1, "sample", 0, 0, "scan")
    return prepare(scene, mini(), rng=rng, effects=effects or Effects())


def test_reference_heat_flow_is_a_gaussian() -> None:
    """A spot on a flat sheet spreads by the sigma asked for, and loses nothing."""
    edge, n = 0.02, 81
    x, y = np.meshgrid(np.linspace(-edge, edge, n), np.linspace(-edge, edge, n))
    sheet = np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)])
    quad = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (quad[:-1, :-1], quad[:-1, 1:], quad[1:, 1:], quad[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    spot = np.zeros(n * n)
    spot[quad[n // 2, n // 2]] = 1
    for sigma in (0.001, 0.002):
        flow = heat_flow(sheet, faces, sigma)
        spread = flow.apply(spot)
        assert flow.mass @ spread == pytest.approx(flow.mass @ spot, rel=1e-3)
        weight = flow.mass * spread
        assert np.sqrt(weight @ sheet[:, 0] ** 2 / weight.sum()) == pytest.approx(sigma, rel=0.02)
        assert spread.min() > -1e-3 * spread.max()


def test_reference_bounce_between_two_walls() -> None:
    """A small patch before a glowing disc receives sin^2 of the angle that the disc spans."""
    disc = trimesh.creation.cylinder(radius=0.02, height=1e-5, sections=96)
    disc.apply_translation((0, 0, 0.02))
    patch = wall(0.002, 0.0)
    scene = ScanScene(
        (solid_from_mesh(disc, PLAIN, smooth=False), solid_from_mesh(patch, PLAIN, smooth=False))
    )
    stage = staged(scene)
    glow = np.ones((len(stage.vertices), 1))
    thrown, open_ = bounce(stage, glow)
    rows = slice(stage.mesh.parts[1].first_vertex, None)
    expected = 0.02**2 / (0.02**2 + 0.02**2)
    assert thrown[rows].mean() == pytest.approx(expected, abs=0.03)
    assert open_[rows].mean() == pytest.approx(1 - expected, abs=0.03)


def test_properties_bounce_lights_the_shade() -> None:
    """Between two palms of light the picture gains, and only there."""
    left, right = wall(0.04, 0.0), wall(0.04, 0.0)
    for mesh, turn in ((left, 0.8), (right, -0.8)):
        mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, (0, 1, 0)))
        mesh.apply_translation((-0.014 if turn > 0 else 0.014, 0, 0))
    bright = Surface(albedo=0.8, specular=0.0, subsurface=0.0)
    scene = ScanScene(tuple(solid_from_mesh(m, bright, smooth=False) for m in (left, right)))
    unit = mini().units[0]
    on, off = (
        speckle_radiance(staged(scene, Effects(bounce=b)), unit, "left") for b in (True, False)
    )
    seen = off > 0.02
    assert seen.sum() > 1000
    assert 1.03 < on[seen].mean() / off[seen].mean() < 1.6


def test_properties_skin_softens_speckle() -> None:
    mesh = ball(0.02, (0, 0, 0))
    contrast, mean = [], []
    for share in (0.0, 0.8):
        surface = Surface(specular=0.0, subsurface=share, subsurface_m=0.0015)
        scene = ScanScene((solid_from_mesh(mesh, surface),))
        picture = speckle_radiance(staged(scene, Effects(bounce=False)), mini().units[0], "left")
        inner = picture[80:110, 110:145]
        contrast.append(inner.std() / inner.mean())
        mean.append(inner.mean())
    assert mean[1] == pytest.approx(mean[0], rel=0.1)
    assert contrast[1] < 0.75 * contrast[0]


def test_properties_shadow_cache_changes_single_pixels_only() -> None:
    unit = mini().units[0]
    cached, exact = (
        speckle_radiance(staged(ball_before_wall(), Effects(vertex_cache=c)), unit, "left", spp=16)
        for c in (True, False)
    )
    assert (np.abs(cached - exact) > 0.01).mean() < 0.002


def test_edge_a_useless_projector_is_noted() -> None:
    rig = mini()
    away = replace(rig.projectors[1], optics=rig.units[0].true.left, ident="lost")
    turned = np.array(away.optics.T) @ np.diag([1.0, -1.0, -1.0, 1.0])
    optics = replace(away.optics, T_world_from_camera=tuple(map(tuple, turned.tolist())))
    aimed_off = replace(rig, projectors=(rig.projectors[0], replace(away, optics=optics)))
    stage = prepare(ball_before_wall(), aimed_off, rng=stream(1, "sample", 0, 0, "scan"))
    soft_light(stage, 0, 0.0)
    assert stage.notes == ["projector lost lights nothing of the subject"]


def test_smoke_repeats() -> None:
    stage = staged(ball_before_wall())
    a, b = (np.array(soft_light(stage, 0, 0.0).vertices) for _ in range(2))
    assert np.isfinite(a).all()
    assert np.array_equal(a, b)
