"""The true disparities of a unit, against geometry written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.geometry.cameras import pixel_rays
from synthgen.sampling.streams import stream
from synthgen.scanner import ScanScene, solid_from_mesh
from synthgen.scanner.ideal import ideal_disparity
from synthgen.scanner.range_grid import triangulate
from synthgen.scanner.rectify import rectify
from synthgen.scanner.rig import Rig
from synthgen.scanner.stage import Stage, prepare
from synthgen.scanner.subject import moved
from tests.scanner.small import PLAIN, ball, from_below, mini, wall

STEP = 3


def exact(rig: Rig) -> Rig:
    return replace(rig, units=tuple(replace(u, true=u.nominal) for u in rig.units))


def staged(scene: ScanScene, rig: Rig) -> Stage:
    return prepare(scene, rig, rng=stream(0, "sample", 0, 0, "scan"))


@pytest.mark.parametrize("time_s", [0.0, 0.01])
def test_reference_a_wall_at_rest_and_in_motion(time_s: float) -> None:
    rig = exact(mini())
    scene = ScanScene((solid_from_mesh(wall(), PLAIN, smooth=False),))
    stage = staged(moved(scene, (0.0, 0.0, 0.5)), rig)
    for unit in rig.units:
        pair = rectify(unit.nominal.left, unit.nominal.right)
        found = ideal_disparity(stage, unit, pair, STEP, time_s=time_s)
        origin, rays = pixel_rays(pair.camera)
        along = (-0.01 + 0.5 * time_s - origin[2]) / rays[..., 2]
        wanted = pair.disparity(along * (rays @ pair.camera.T[:3, 2]))[::STEP, ::STEP]
        known = np.isfinite(found)
        assert known.mean() > 0.35
        assert np.abs(found - wanted)[known].max() < 1e-4


def test_reference_a_ball_through_glass() -> None:
    """What is triangulated with refraction lies on the ball, up to rays that miss each other."""
    rig = exact(from_below(mini()))
    stage = staged(ScanScene((solid_from_mesh(ball(0.018, (0, 0, 0)), PLAIN),)), rig)
    for unit in rig.units:
        pair = rectify(unit.nominal.left, unit.nominal.right)
        found = ideal_disparity(stage, unit, pair, STEP, time_s=0.0).astype(np.float64)
        rows, columns = np.indices(found.shape) * STEP
        points = triangulate(pair, columns, rows, found, rig.glass)[np.isfinite(found)]
        assert len(points) > 500
        off = np.linalg.norm(points, axis=1) - 0.018
        assert np.abs(off).max() < 2e-4
        straight = triangulate(pair, columns, rows, found)[np.isfinite(found)]
        assert np.abs(np.linalg.norm(straight, axis=1) - 0.018).max() > 1e-3
