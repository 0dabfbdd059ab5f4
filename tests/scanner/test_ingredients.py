"""Every ingredient of a scanner that has a name does what its name says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from synthgen.sampling.streams import stream
from synthgen.scanner import (
    Effects,
    ScanScene,
    expose,
    expose_colour,
    list_rigs,
    load_rig,
    scan,
    settings_for,
    solid_from_mesh,
)
from synthgen.scanner.exposure import speckle_radiance
from synthgen.scanner.rig import Rig
from synthgen.scanner.stage import Stage, prepare
from synthgen.scanner.subject import moved
from tests.scanner.small import PLAIN, ball, ball_before_wall, mini, quiet, wall

BALL = trimesh.creation.icosphere(subdivisions=5, radius=0.018)
DIRECT = Effects(subsurface=False, bounce=False)


def staged(scene: ScanScene, rig: Rig, effects: Effects = DIRECT) -> Stage:
    return prepare(scene, rig, rng=stream(3, "sample", 0, 0, "scan"), effects=effects)


def centre(mask: np.ndarray) -> float:
    """Mean column of a mask's pixels."""
    return float(np.nonzero(mask)[1].mean())


@pytest.mark.parametrize("kind", ["speckle", "dots", "laser", "image"])
def test_smoke_every_pattern_is_matched(kind: str, tmp_path: Path) -> None:
    words = f"kind: {kind}, fill: 0.3"
    if kind == "image":
        noise = stream(0, "sample", 0, 0, "picture").integers(0, 256, (96, 96), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / "mine.png"), noise)
        words = "kind: image, image: mine.png"
    text = list_rigs()["mini"].read_text()
    assert "kind: speckle" in text
    path = tmp_path / "own.yaml"
    path.write_text(text.replace("kind: speckle", words))
    rig = load_rig(path)
    settings = replace(settings_for(rig), colour=False)
    found = scan(BALL, rig, rng=stream(0, "sample", 0, 0, "scan"), settings=settings)
    assert found.problem is None
    for unit in found.report["units"].values():
        assert unit["matched"] > 0.6 * unit["lit"]
    assert np.sqrt(np.mean(found.provenance["error_m"] ** 2)) < 0.0008


def test_reference_projectors_light_their_own_slot_only() -> None:
    rig = quiet(mini())
    front, right = rig.projectors
    units = (rig.units[0], replace(rig.units[1], slot=1))
    scheduled = replace(rig, units=units, projectors=(front, replace(right, slot=1)))
    alone = replace(rig, projectors=(front,))
    scene = ScanScene((solid_from_mesh(wall(), PLAIN, smooth=False),))
    got, expected, both = (
        speckle_radiance(staged(scene, r), r.units[0], "left") for r in (scheduled, alone, rig)
    )
    assert np.array_equal(got, expected)
    assert both.sum() > 1.2 * got.sum()
    assert [p.ident for p in scheduled.lit_by(units[1])] == [right.ident]


def test_properties_a_later_slot_sees_what_has_moved() -> None:
    speed, wait = 0.2, 0.02
    rig = replace(quiet(mini()), slot_s=wait)
    scene = moved(ScanScene((solid_from_mesh(ball(), PLAIN),)), (speed, 0.0, 0.0))
    at = []
    for slot in (0, 1):
        front = replace(rig.units[0], slot=slot)
        lights = tuple(replace(p, slot=slot) for p in rig.projectors)
        used = replace(rig, units=(front,), projectors=lights)
        at.append(centre(speckle_radiance(staged(scene, used), front, "left") > 0.01))
    pixel = 0.0004 * 0.59 / 0.6
    assert at[1] - at[0] == pytest.approx(speed * wait / pixel, rel=0.05)


def test_properties_white_light_follows_speckle() -> None:
    """The body scanner's lights alternate at 120 Hz: colour lags behind the shape."""
    delay = load_rig("body22").light.white_delay_s
    assert delay == pytest.approx(1 / 120)
    speed, at = 1.0, []
    scene = moved(ScanScene((solid_from_mesh(ball(0.008), PLAIN),)), (speed, 0.0, 0.0))
    for wait in (0.0, delay):
        rig = mini()
        rig = replace(rig, light=replace(rig.light, white_delay_s=wait))
        picture = expose_colour(staged(scene, rig), rig.units[0])
        at.append(centre(picture.max(axis=2) > 60))
    assert (at[1] - at[0]) * 0.0004 == pytest.approx(speed * delay, rel=0.06)


def test_properties_every_effect_has_a_switch() -> None:
    """Off, each changes the picture the way it must."""
    rig, scene = quiet(mini()), ball_before_wall()
    unit = rig.units[0]

    def taken(**off: bool) -> np.ndarray:
        effects = Effects(**({"subsurface": False, "bounce": False} | off))
        return speckle_radiance(staged(scene, rig, effects), unit, "left")

    usual = taken()
    assert np.all(taken(shadows=False) >= usual - 1e-3)
    assert taken(shadows=False).sum() > 1.01 * usual.sum()
    assert taken(specular=False).sum() < usual.sum()
    assert taken(bounce=True).sum() > usual.sum()
    inner = np.s_[20:40, 60:200]
    assert taken(defocus=False)[inner].std() > usual[inner].std()
    skin = ScanScene((solid_from_mesh(ball(), replace(PLAIN, subsurface=0.6)),))
    hard, soft = (
        speckle_radiance(staged(skin, rig, replace(DIRECT, subsurface=s)), unit, "left")[85:105]
        for s in (False, True)
    )
    assert soft[soft > 0.02].std() < 0.95 * hard[hard > 0.02].std()


def test_reference_projectors_darken_towards_their_edge() -> None:
    rig = quiet(mini())
    scene = ScanScene((solid_from_mesh(wall(), PLAIN, smooth=False),))
    light = replace(rig.light, ambient=0.0, background=0.0)
    pictures = []
    for power in (0.0, 4.0):
        lamps = tuple(replace(p, vignetting=power) for p in rig.projectors[:1])
        own = replace(rig, projectors=lamps, light=light)
        pictures.append(speckle_radiance(staged(scene, own), own.units[0], "left"))
    ratio = pictures[1] / np.maximum(pictures[0], 1e-6)
    lit = pictures[0] > 0.05
    optics = rig.projectors[0].optics
    corners = np.array([[x, y, -0.01] for x in (-0.05, 0.05) for y in (-0.05, 0.05)])
    away = corners - optics.position
    cosines = away @ optics.T[:3, 2] / np.linalg.norm(away, axis=1)
    assert ratio[lit].min() == pytest.approx(cosines.min() ** 4, abs=0.02)
    assert ratio[lit].max() == pytest.approx(1.0, abs=0.01)


def test_reference_ambient_light_adds_evenly() -> None:
    rig = quiet(mini())
    scene = ScanScene((solid_from_mesh(wall(), PLAIN, smooth=False),))
    a, b = (
        speckle_radiance(
            staged(scene, replace(rig, light=replace(rig.light, ambient=level))),
            rig.units[0],
            "left",
        )
        for level in (0.0, 0.2)
    )
    inner = np.s_[60:130, 80:170]
    np.testing.assert_allclose((b - a)[inner], 0.2 * PLAIN.albedo, atol=1e-4)


def test_properties_exposure_is_automatic_or_given() -> None:
    scene = ScanScene((solid_from_mesh(BALL, PLAIN),))
    for brightness in (1.0, 0.01):
        rig = mini()
        lamps = tuple(replace(p, irradiance=brightness * p.irradiance) for p in rig.projectors)
        dark = replace(rig.light, ambient=0.0, background=0.0)
        rig = replace(rig, projectors=lamps, light=dark)
        shot = expose(staged(scene, rig), rig.units[0])
        assert shot.problem is None
        lit = shot.left[shot.left > 12]
        assert np.quantile(lit, 0.99) == pytest.approx(0.8 * 255, rel=0.08), brightness
    fixed = replace(mini(), grey=replace(mini().grey, gain=0.7))
    assert expose(staged(scene, fixed), fixed.units[0]).gain == 0.7
