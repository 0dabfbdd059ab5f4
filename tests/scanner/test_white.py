"""Colour pictures: shadows, colours, the green rule's raw material, automatic exposure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.sampling.streams import stream
from synthgen.scanner import ScanScene, Surface, solid_from_mesh
from synthgen.scanner.rig import Rig
from synthgen.scanner.stage import prepare
from synthgen.scanner.subject import GREEN, SKIN
from synthgen.scanner.white import expose_colour, white_light
from tests.scanner.small import ball, mini, wall


def pictured(scene: ScanScene, rig: Rig | None = None) -> np.ndarray:
    rig = rig or mini()
    return expose_colour(prepare(scene, rig, rng=stream(2, "sample", 0, 0, "x")), rig.units[0])


def two_balls(skin: Surface = SKIN) -> ScanScene:
    return ScanScene(
        (
            solid_from_mesh(ball(0.012, (-0.015, 0, 0)), skin),
            solid_from_mesh(ball(0.012, (0.015, 0, 0)), GREEN, kind="object"),
        )
    )


def test_smoke_skin_and_green() -> None:
    picture = pictured(two_balls()).astype(int)
    r, g, _ = picture.transpose(2, 0, 1)
    skin, green = (slice(80, 110), slice(75, 105)), (slice(80, 110), slice(150, 180))
    rule = g > np.maximum(r, 20)
    assert rule[green].mean() > 0.99
    assert rule[skin].mean() < 0.01
    assert (picture[:5] < 30).all()  # nothing behind


@pytest.mark.parametrize("tone", [(0.8, 0.6, 0.5), (0.3, 0.15, 0.09), (0.12, 0.06, 0.04)])
def test_properties_tones_are_exposed_for(tone: tuple[float, float, float]) -> None:
    scene = ScanScene((solid_from_mesh(ball(0.02, (0, 0, 0)), replace(SKIN, rgb=tone)),))
    picture = pictured(scene)
    middle = picture[80:110, 110:145].reshape(-1, 3).mean(axis=0)
    assert 60 < middle[1] < 235
    assert middle[0] > middle[1] > middle[2]


def test_properties_vertex_colours() -> None:
    mesh = ball(0.02, (0, 0, 0))
    red, blue = (0.6, 0.05, 0.05), (0.05, 0.05, 0.6)
    colours = np.where(mesh.vertices[:, :1] < 0, red, blue)
    solid = solid_from_mesh(mesh, replace(SKIN, specular=0.0), colours=colours)
    picture = pictured(ScanScene((solid,))).astype(int)
    left, right = picture[90:100, 90:100], picture[90:100, 156:166]
    assert (left[..., 0] > left[..., 2]).all()
    assert (right[..., 2] > right[..., 0]).all()


def test_reference_irradiance_and_shadow_of_a_panel() -> None:
    """All of a panel's light reaches a facing sheet, and none behind a ball in its way."""
    rig = replace(mini(), light=replace(mini().light, white=((0.0, 0.0, 0.6),), white_size_m=0.02))
    sheet = solid_from_mesh(wall(0.05, 0.0), replace(SKIN, subsurface=0.0), smooth=False)
    blocker = solid_from_mesh(ball(0.006, (0, 0, 0.02)), SKIN)
    for scene, middle in ((ScanScene((sheet,)), 1.0), (ScanScene((sheet, blocker)), 0.0)):
        stage = prepare(scene, rig, rng=stream(2, "sample", 0, 0, "x"))
        share = np.array(white_light(stage, 0.0).normals).reshape(-1, 4)[:, 3]
        at = np.linalg.norm(stage.vertices, axis=1) < 0.002
        assert share[at].mean() == pytest.approx(middle, abs=0.01)


def test_edge_no_panels_are_an_even_surround() -> None:
    rig = replace(mini(), light=replace(mini().light, white=()))
    scene = ScanScene((solid_from_mesh(ball(0.02, (0, 0, 0)), replace(SKIN, rgb=(0.5, 0.3, 0.2))),))
    picture = pictured(scene, rig).astype(float)
    middle, rim = picture[85:105, 118:138], picture[90:102, 82:88]
    assert middle.reshape(-1, 3).std(axis=0).max() < 12
    assert rim.mean() > 0.85 * middle.mean()
    assert middle[..., 0].mean() > middle[..., 1].mean() > middle[..., 2].mean()
