"""The speckle kernel against the readable reference, ray by ray; shadows, gloss, glass."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from synthgen.errors import ConfigError
from synthgen.geometry.cameras import camera_from_K, project
from synthgen.render import backend
from synthgen.scanner import ScanScene, light_reference, solid_from_mesh
from synthgen.scanner.camera import Lens, speckle_look, undistort_steps
from synthgen.scanner.mesh import drawn_mesh
from synthgen.scanner.rig import Rig
from synthgen.scanner.softlight import soft_light
from synthgen.scanner.stage import Effects, Stage, prepare
from tests.scanner.small import PLAIN, ball, ball_before_wall, from_below, mini

DIRECT = Effects(subsurface=False, bounce=False)


def looked(stage: Stage, camera: Any, pixels: np.ndarray) -> np.ndarray:
    mi = backend.mitsuba()
    soft = soft_light(stage, 0, 0.0)
    x, y = (mi.Float(c) for c in np.ascontiguousarray(pixels.T, dtype=np.float32))
    still = mi.Vector3f(0, 0, 0)
    rays = Lens(stage, camera).rays(x, y, still)
    return np.array(speckle_look(stage, soft)(rays, still, mi.Bool(True))[0])


def grid(camera: Any, step: int) -> np.ndarray:
    y, x = np.mgrid[3 : camera.height : step, 3 : camera.width : step]
    return np.stack([x.ravel(), y.ravel()], axis=1) + 0.25


def compare(scene: ScanScene, rig: Rig, effects: Effects = DIRECT) -> tuple[np.ndarray, np.ndarray]:
    stage = prepare(scene, rig, rng=np.random.Generator(np.random.Philox(1)), effects=effects)
    camera = rig.units[0].true.left
    pixels = grid(camera, 9)
    wanted = light_reference.radiance(drawn_mesh(scene, np.inf), rig, camera, pixels, 0)
    return looked(stage, camera, pixels), wanted


@pytest.mark.parametrize("vertex_cache", [False, True])
def test_reference_ball_before_wall(vertex_cache: bool) -> None:
    """Direct light, shadow, gloss, defocus: equal but for single rays at shadow borders."""
    effects = replace(DIRECT, vertex_cache=vertex_cache)
    got, wanted = compare(ball_before_wall(), mini(), effects)
    assert (wanted > 0.01).mean() > 0.5
    off = np.abs(got - wanted) > 2e-3
    assert off.mean() < (0.004 if vertex_cache else 0.002)
    assert np.abs(got - wanted)[~off].max() < 2e-3
    assert np.median(np.abs(got - wanted)) < 1e-4


@pytest.mark.parametrize("focus", [0.55, 0.45, 0.3])
def test_reference_far_out_of_focus(focus: float) -> None:
    """Every level of the slides' pyramids, down to the last and beyond."""
    rig = mini()
    blurred = replace(rig, projectors=tuple(replace(p, focus_m=focus) for p in rig.projectors))
    got, wanted = compare(ball_before_wall(), blurred)
    assert (wanted > 0.01).mean() > 0.5
    assert (np.abs(got - wanted) > 2e-3).mean() < 0.004


def test_reference_through_glass() -> None:
    scene = ScanScene((solid_from_mesh(ball(0.015, (0, 0, 0)), PLAIN),))
    got, wanted = compare(scene, from_below(mini()))
    assert (wanted > 0.01).sum() > 40
    off = np.abs(got - wanted) > 2e-3
    assert off.mean() < 0.004


@pytest.mark.parametrize("k1", [-0.1, 0.15])
def test_reference_rays_of_wide_lenses(k1: float) -> None:
    """A ray goes where the calibration says, also at the corners of a field of 89 degrees."""
    K = np.array([[431.0, 0, 423.5], [0, 431, 239.5], [0, 0, 1]])
    usual = mini().units[0].true.left
    wide = camera_from_K(K, 848, 480, usual.T, np.array([k1, 0.0, 0, 0, 0]))
    stage = prepare(ball_before_wall(), mini(), rng=np.random.Generator(np.random.Philox(1)))
    mi = backend.mitsuba()
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(0, 847, 12), np.linspace(0, 479, 8)))
    rays = Lens(stage, wide).rays(mi.Float(x), mi.Float(y), mi.Vector3f(0))
    there, _ = project(wide, wide.position + np.array(rays.way).T.astype(np.float64))
    assert np.abs(there - np.stack([x, y], axis=1)).max() < 2e-3
    assert undistort_steps(usual) == 6, "rigs of usual lenses share a kernel"
    with pytest.raises(ConfigError, match="folds the picture"):
        undistort_steps(replace(wide, distortion=(-0.12, 0.0, 0.0, 0.0, 0.0)))


def test_properties_a_shadow_falls_on_the_wall() -> None:
    """Where the ball stands between projector and wall only ambient light is left."""
    scene = ball_before_wall()
    rig = replace(mini(), projectors=mini().projectors[1:])  # the other unit's, from the side
    with_shadow = compare(scene, rig)[0]
    without = compare(scene, rig, replace(DIRECT, shadows=False))[0]
    assert (with_shadow <= without + 1e-4).all()
    shaded = (without > 0.1) & (with_shadow < 0.5 * rig.light.ambient + 1e-3)
    assert shaded.sum() > 5


def test_properties_power_falls_with_the_square_of_the_distance() -> None:
    rig = mini()
    near, far = (
        replace(
            rig,
            projectors=tuple(
                replace(p, pattern=replace(p.pattern, fill=0.98), aperture_m=0.0, irradiance=e)
                for p in rig.projectors
            ),
        )
        for e in (0.5, 0.125)
    )
    a, b = (compare(ball_before_wall(), r, replace(DIRECT, specular=False))[0] for r in (near, far))
    lit = a > 0.1
    ambient = 0.4 * rig.light.ambient
    assert np.median((a[lit] - ambient) / (b[lit] - ambient)) == pytest.approx(4, rel=0.05)


def test_properties_defocus_lowers_contrast() -> None:
    rig = mini()
    blurred = replace(rig, projectors=tuple(replace(p, focus_m=0.45) for p in rig.projectors))
    contrast = []
    for r in (rig, blurred):
        got = compare(ball_before_wall(), r, replace(DIRECT, specular=False))[0]
        contrast.append(got[got > 0.05].std() / got[got > 0.05].mean())
    assert contrast[1] < 0.5 * contrast[0]
