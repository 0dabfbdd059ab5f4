"""Depth as a consumer camera reports it, against the exact depth of the same scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from synthgen.errors import ConfigError
from synthgen.geometry.cameras import Camera, camera_from_K
from synthgen.geometry.transforms import apply, look_at
from synthgen.sampling.streams import stream
from synthgen.scanner import ScanScene, load_rig, solid_from_mesh
from synthgen.scanner.depth_sensor import SensorDepth, device_for, sense_depth
from tests.scanner.small import PLAIN, ball, wall

PLACE = look_at(np.array([1.2, 1.5, 0.1]), np.array([1.0, 1.0, 0.0]))
W, H = 160, 120


def view(distortion: float = 0.0) -> Camera:
    K = np.array([[220.0, 0, W / 2 - 0.5], [0, 220, H / 2 - 0.5], [0, 0, 1]])
    return camera_from_K(K, W, H, PLACE, np.array([distortion, 0, 0, 0, 0]))


def in_view(mesh: trimesh.Trimesh, x: float, y: float, z: float) -> trimesh.Trimesh:
    """The mesh at a place of the camera's frame, turned with it, in the world."""
    turned = np.asarray(mesh.vertices) * [1, -1, -1] + [x, y, z]
    return trimesh.Trimesh(apply(PLACE, turned), mesh.faces, process=False)


def scene(distance: float = 0.7) -> ScanScene:
    back = in_view(wall(1.6, 0.0), 0, 0, distance)
    front = in_view(ball(0.05, (0, 0, 0)), 0.02, 0.01, 0.45)
    return ScanScene(
        (
            solid_from_mesh(front, PLAIN),
            solid_from_mesh(back, PLAIN, smooth=False, kind="stand"),
        )
    )


def measured(**changes: object) -> SensorDepth:
    rig = load_rig("consumer")
    values: dict[str, object] = {
        "scene": scene(),
        "camera": view(),
        "rig": rig,
        **changes,
    }
    rng = stream(0, "sample", 0, 0, "depth sensor")
    return sense_depth(rng=rng, **values)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def usual() -> SensorDepth:
    return measured()


def test_smoke(usual: SensorDepth) -> None:
    assert usual.problem is None
    assert usual.depth_z_m.shape == (H, W)
    assert usual.depth_z_m.dtype == np.float32
    assert (usual.depth_z_m >= 0).all()


def test_reference_wall(usual: SensorDepth) -> None:
    """The wall behind, within half a pixel of disparity; nothing where one camera is blind."""
    depth = usual.depth_z_m
    corner = depth[5:25, 80:150]
    seen = corner[corner > 0]
    assert len(seen) > 0.9 * corner.size
    assert np.median(seen) == pytest.approx(0.7, abs=0.5 * 0.7**2 / (431 * 0.05))
    assert np.abs(seen - np.median(seen)).max() < 0.05
    assert (depth[:, :6] == 0).mean() > 0.9


def test_reference_ball(usual: SensorDepth) -> None:
    """The ball's nearest point is 0.40 m away; beside it the second camera is blind."""
    camera = view()
    column = round(camera.cx + camera.fx * 0.02 / 0.4)
    row = round(camera.cy + camera.fy * 0.01 / 0.4)
    near = usual.depth_z_m[row - 2 : row + 3, column - 2 : column + 3]
    assert np.median(near[near > 0]) == pytest.approx(0.4, abs=0.004)
    left = column - round(camera.fx * 0.05 / 0.45)
    band = usual.depth_z_m[row - 3 : row + 4, left - 9 : left - 2]
    assert (band == 0).mean() > 0.25


def test_properties_repeats_and_differs_by_seed(usual: SensorDepth) -> None:
    assert np.array_equal(usual.depth_z_m, measured().depth_z_m)
    other = measured(rig=load_rig("consumer", 1)).depth_z_m
    assert not np.array_equal(usual.depth_z_m, other)


def test_properties_half_resolution_sees_the_same_more_coarsely(usual: SensorDepth) -> None:
    half = measured(level="half").depth_z_m
    assert half.shape == (H, W)
    both = (half > 0) & (usual.depth_z_m > 0)
    assert both.mean() > 0.6
    assert np.median(np.abs(half - usual.depth_z_m)[both]) < 0.01
    spread = [np.abs(d - 0.7)[5:25, 80:150][both[5:25, 80:150]] for d in (half, usual.depth_z_m)]
    assert np.median(spread[0]) > 1.3 * np.median(spread[1]), "a pixel is twice the depth"
    with pytest.raises(ConfigError, match="levels are full, half, model"):
        measured(level="quarter")


def test_properties_too_near_is_not_measured() -> None:
    """The device searches 126 disparities: nothing nearer than 431 * 50 mm / 126 = 0.17 m."""
    near = in_view(wall(0.3, 0.0), 0, 0, 0.12)
    depth = measured(scene=ScanScene((solid_from_mesh(near, PLAIN, smooth=False),))).depth_z_m
    assert (np.abs(depth - 0.12) < 0.01).mean() < 0.02


def test_properties_errors_grow_with_distance() -> None:
    """Noise of depth grows with its square."""
    spread = []
    for distance in (0.6, 1.8):
        patch = measured(scene=scene(distance)).depth_z_m[5:25, 90:150]
        seen = patch[patch > 0.5]
        assert len(seen) > 300
        spread.append(np.quantile(np.abs(seen - np.median(seen)), 0.68))
    assert spread[1] > 2 * spread[0]


def test_properties_distorted_view_shares_its_pixels(usual: SensorDepth) -> None:
    """A view with distortion has the ball where it sees it, not where a pinhole would."""
    bent = measured(camera=view(-0.3)).depth_z_m
    for depth in (usual.depth_z_m, bent):
        assert ((depth > 0.3) & (depth < 0.5)).sum() > 800
    sizes = [((d > 0.3) & (d < 0.5)).sum() for d in (usual.depth_z_m, bent)]
    assert sizes[1] < sizes[0]


def test_edge_nothing_lit() -> None:
    rig = load_rig("consumer")
    dark = replace(rig, projectors=tuple(replace(p, irradiance=1e-9) for p in rig.projectors))
    found = measured(rig=dark)
    assert found.problem is not None
    assert "black speckle" in found.problem
    assert not found.depth_z_m.any()


def test_edge_no_depth_camera() -> None:
    with pytest.raises(ConfigError, match="rig mini is no depth camera"):
        device_for(load_rig("mini"), view())
