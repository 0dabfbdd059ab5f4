"""Pictures of a unit: determinism, sampling, shutters, motion, black speckle, truth behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from synthgen.errors import ScanError
from synthgen.geometry.cameras import project
from synthgen.sampling.streams import stream
from synthgen.scanner import ScanScene, light_reference, solid_from_mesh
from synthgen.scanner.exposure import expose, speckle_radiance, unit_time
from synthgen.scanner.mesh import drawn_mesh
from synthgen.scanner.rig import Rig
from synthgen.scanner.stage import Effects, Stage, prepare
from synthgen.scanner.subject import moved
from synthgen.scanner.truth import see, seen_from
from synthgen.scanner.white import expose_colour
from tests.scanner.small import PLAIN, ball, ball_before_wall, from_below, mini, quiet, wall

DIRECT = Effects(subsurface=False, bounce=False)


def staged(scene: ScanScene, rig: Rig, effects: Effects = DIRECT, seed: int = 5) -> Stage:
    return prepare(scene, rig, rng=stream(seed, "sample", 0, 0, "scan"), effects=effects)


def skin() -> trimesh.Trimesh:
    return ball(0.02, (0, 0, 0))


def with_grey(rig: Rig, **changes: object) -> Rig:
    return replace(rig, grey=replace(rig.grey, **changes))  # type: ignore[arg-type]


def test_smoke_pictures() -> None:
    rig = mini()
    stage = staged(ScanScene((solid_from_mesh(skin()),)), rig, Effects())
    assert not stage.notes
    shot = expose(stage, rig.units[0])
    assert shot.problem is None
    for picture in (shot.left, shot.right):
        assert picture.shape == (192, 256)
        assert picture.dtype == np.uint8
        seen = picture[picture > 20]
        assert len(seen) > 2000
        assert seen.std() / seen.mean() > 0.2  # speckle
    colour = expose_colour(stage, rig.units[0])
    assert colour.shape == (192, 256, 3)
    inside = colour[90:100, 125:135].reshape(-1, 3).mean(axis=0)
    assert inside[0] > inside[1] > inside[2] > 60  # skin


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_properties_same_seed_same_bytes_in_any_order(speed: float) -> None:
    """Also where the subject moves and the units do not fire together."""
    rig = replace(mini(), sync_s=0.00075)
    scene = moved(ScanScene((solid_from_mesh(skin()),)), (speed, 0.0, 0.0))
    first, second = staged(scene, rig, Effects()), staged(scene, rig, Effects())
    a = [expose(first, unit) for unit in rig.units]
    b = [expose(second, unit) for unit in reversed(rig.units)][::-1]
    for one, other in zip(a, b, strict=True):
        assert np.array_equal(one.left, other.left)
        assert np.array_equal(one.right, other.right)
    colours = [expose_colour(first, unit) for unit in rig.units]
    again = [expose_colour(second, unit) for unit in reversed(rig.units)][::-1]
    assert all(np.array_equal(*pair) for pair in zip(colours, again, strict=True))
    other = expose(staged(scene, rig, Effects(), seed=6), rig.units[0])
    assert not np.array_equal(a[0].left, other.left)


def test_reference_sub_samples_average_the_pixel() -> None:
    """256 stratified sub-samples are the mean of the reference over the pixel."""
    rig = mini()
    stage = staged(ball_before_wall(), rig)
    unit, camera = rig.units[0], rig.units[0].true.left
    picture = speckle_radiance(stage, unit, "left", spp=256)
    pixels = [(128, 96), (140, 96), (100, 70), (60, 120), (115, 110)]
    inner = (np.arange(12) + 0.5) / 12 - 0.5
    plain = drawn_mesh(ball_before_wall(), np.inf)
    for x, y in pixels:
        at = np.stack([g.ravel() for g in np.meshgrid(x + inner, y + inner)], axis=1)
        wanted = light_reference.radiance(plain, rig, camera, at, 0).mean()
        assert picture[y, x] == pytest.approx(wanted, abs=0.004)


def test_properties_motion_blurs_along_the_motion() -> None:
    rig = with_grey(quiet(mini()), exposure_s=0.002)
    scene = ScanScene((solid_from_mesh(wall(), PLAIN, smooth=False),))
    unit = rig.units[0]
    still = speckle_radiance(staged(scene, rig), unit, "left", spp=16)
    fast = speckle_radiance(staged(moved(scene, (0, 0, 0.0)), rig), unit, "left", spp=16)
    assert np.array_equal(still, fast)
    # The pattern stays where it is and the wall slides under it: nothing to see but its edges.
    aside = speckle_radiance(staged(moved(scene, (1.0, 0, 0)), rig), unit, "left", spp=16)
    inner = np.s_[60:130, 80:170]
    assert np.abs(aside - still)[inner].max() < 0.02
    # Towards the unit: the pattern runs over the picture.
    near = speckle_radiance(staged(moved(scene, (0, 0, 3.0)), rig), unit, "left", spp=16)
    gradient = [np.abs(np.diff(p[inner], axis=0)).mean() for p in (still, near)]
    assert gradient[1] < 0.85 * gradient[0]


def test_reference_sub_poses_equal_the_rigid_shift() -> None:
    """Two solids that move alike, said in two ways: as one, and vertex by vertex."""
    rig = with_grey(quiet(mini()), exposure_s=0.002)
    velocity = np.array([0.3, 0.2, 0.4])
    rigid = moved(ScanScene((solid_from_mesh(ball(), PLAIN),)), tuple(velocity))
    solid = rigid.solids[0]
    each = np.tile(velocity, (len(solid.vertices), 1))
    each[0] += 1e-9  # not quite as one, so that the scene is posed four times
    posed = ScanScene((replace(solid, velocity_m_s=each),))
    a, b = staged(rigid, rig), staged(posed, rig)
    assert a.rigid
    assert not b.rigid
    unit = rig.units[0]
    one, other = (speckle_radiance(s, unit, "left", spp=16) for s in (a, b))
    assert np.abs(one - other).mean() < 0.01 * one.mean()


def test_properties_rolling_shutter_shears() -> None:
    """With 20 us from row to row a ball at 2 m/s is sheared by 0.04 mm per row."""
    speed, delay = 2.0, 2e-5
    scene = moved(ScanScene((solid_from_mesh(skin(), PLAIN),)), (speed, 0.0, 0.0))
    rig = with_grey(quiet(mini()), exposure_s=1e-5, line_delay_s=delay)
    unit = rig.units[0]
    rolling = speckle_radiance(staged(scene, rig), unit, "left") > 0.01
    still = with_grey(rig, line_delay_s=0.0)
    whole = speckle_radiance(staged(scene, still), unit, "left") > 0.01
    column = np.arange(256)
    rows = [70, 120]
    drift = [
        (rolling[r] @ column) / rolling[r].sum() - (whole[r] @ column) / whole[r].sum()
        for r in rows
    ]
    per_row = speed * delay / 0.0004  # pixels
    assert drift[1] - drift[0] == pytest.approx(per_row * 50, abs=0.6)


def test_properties_units_fire_when_they_do() -> None:
    rig = replace(mini(), sync_s=0.001, slot_s=0.1)
    late = replace(rig, units=(rig.units[0], replace(rig.units[1], slot=1)))
    stage = staged(ScanScene((solid_from_mesh(skin(), PLAIN),)), late)
    times = [unit_time(stage, unit) for unit in late.units]
    assert 0 < abs(times[0]) <= 0.001
    assert times[1] == pytest.approx(0.1, abs=0.001)
    assert times[0] == unit_time(stage, late.units[0])


def test_reference_truth_behind_the_pixels() -> None:
    rig = mini()
    scene = ball_before_wall()
    stage = staged(scene, rig)
    camera, other = rig.units[0].true.left, rig.units[0].true.right
    y, x = np.mgrid[2:190:6, 2:254:6]
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    sight = see(stage, camera, pixels)
    hit = sight.solid >= 0
    assert {0, 1} <= set(sight.solid[hit])
    again, z = project(camera, sight.point_m[hit])
    assert np.abs(again - pixels[hit]).max() < 1e-9
    assert np.abs(z - sight.depth_z_m[hit]).max() < 1e-12
    for k, solid in enumerate(scene.solids):
        at = sight.solid == k
        corners = solid.vertices[solid.faces[sight.face[at]]]
        rebuilt = np.einsum("nk,nkj->nj", sight.barycentric[at], corners)
        assert np.abs(rebuilt - sight.point_m[at]).max() < 1e-9
    assert seen_from(stage, camera, sight.point_m)[hit].mean() > 0.995
    behind = ~seen_from(stage, other, sight.point_m) & hit
    assert 5 < behind.sum() < 0.5 * hit.sum()  # the ball hides some wall
    assert not seen_from(stage, camera, np.array([[0.0, 0.0, -0.5], [np.nan] * 3])).any()


def test_reference_truth_through_glass_and_in_motion() -> None:
    rig = from_below(mini())
    scene = moved(ScanScene((solid_from_mesh(skin(), PLAIN),)), (0.5, 0.0, 0.0))
    stage = staged(scene, rig)
    camera = rig.units[0].true.left
    pixels = np.array([[x, y] for x in (100.0, 128.0, 150.0) for y in (80.0, 96.0, 120.0)])
    then, now = (see(stage, camera, pixels, time_s=t) for t in (0.002, 0.0))
    assert (now.solid == 0).all()
    radius = np.linalg.norm(now.point_m, axis=1)
    assert np.abs(radius - 0.02).max() < 2e-4
    moved_radius = np.linalg.norm(then.point_m - [0.001, 0, 0], axis=1)
    assert np.abs(moved_radius - 0.02).max() < 2e-4
    assert seen_from(stage, camera, now.point_m).all()


def test_edge_black_speckle_is_told() -> None:
    """Intensity of a lamp in a scene in millimetres, as in other renderers: nothing arrives."""
    rig = mini()
    dim = replace(
        rig, projectors=tuple(replace(p, irradiance=p.irradiance / 3.6e5) for p in rig.projectors)
    )
    shot = expose(staged(ScanScene((solid_from_mesh(skin()),)), dim), dim.units[1])
    assert shot.problem is not None
    assert "unit right: black speckle" in shot.problem
    assert "projector.irradiance" in shot.problem
    assert "front/0" in shot.problem


def test_edge_underexposed_and_empty_views_are_told() -> None:
    rig = with_grey(mini(), gain=1e-3)
    shot = expose(staged(ScanScene((solid_from_mesh(skin()),)), rig), rig.units[0])
    assert shot.problem is not None
    assert "the picture is black" in shot.problem
    far = ball(0.004, (0, 0.025, 0))
    far.apply_translation((0.0, 0.0, 0.0))
    aside = mini()
    turned = replace(aside.units[0].true.left, cx=4000.0, distortion=(0.0,) * 5)
    unit = replace(aside.units[0], true=replace(aside.units[0].true, left=turned))
    blind = replace(aside, units=(unit, aside.units[1]))
    shot = expose(staged(ScanScene((solid_from_mesh(far),)), blind), unit)
    assert shot.problem is not None
    assert "left camera sees nothing" in shot.problem


def test_edge_placement() -> None:
    rig = mini()
    for mesh, words in (
        (ball(0.02, (0, 0.5, 0)), "working volume"),
        (trimesh.creation.icosphere(radius=0.7, subdivisions=3), "working volume"),
    ):
        with pytest.raises(ScanError, match=words):
            staged(ScanScene((solid_from_mesh(mesh),)), rig)
    shell = trimesh.util.concatenate([ball(0.01, (0, 0, 0)), ball(0.2, (0.06, 0.1, 0.6))])
    with pytest.raises(ScanError, match=r"unit front: the left camera .* is inside solid 0"):
        staged(ScanScene((solid_from_mesh(shell),)), rig)
    with pytest.raises(ScanError, match="no solid"):
        staged(ScanScene(()), rig)


def test_edge_too_coarse_for_skin_is_noted() -> None:
    """Two million triangles are the end: a body-sized wall cannot blur by a millimetre."""
    big = trimesh.creation.box((0.05, 0.05, 2000.0))
    stage = staged(ScanScene((solid_from_mesh(big, smooth=False),)), mini(), Effects())
    assert stage.skins == [None]
    assert any("too coarse" in note for note in stage.notes)
