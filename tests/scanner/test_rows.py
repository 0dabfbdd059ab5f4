"""Rows that do not correspond: found to hundredths of a pixel, put right, and matched again."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from synthgen.errors import ConfigError
from synthgen.sampling.streams import stream
from synthgen.scanner import Scan, load_rig, scan, settings_for
from synthgen.scanner.calibration import volume_points
from synthgen.scanner.evaluate import pair_figures
from synthgen.scanner.ideal import project_through
from synthgen.scanner.load import build_rig, list_rigs, read_spec
from synthgen.scanner.match import MatchSettings
from synthgen.scanner.pattern import slide
from synthgen.scanner.rectify import rectified_pixels, rectify, rectify_images
from synthgen.scanner.rig import Pattern, Rig
from synthgen.scanner.rows import RowOffset, find_row_offset, refracted_rows
from tests.scanner.small import from_below

H, W = 240, 320
SEARCH = MatchSettings(rows=4)


def speckle() -> np.ndarray:
    return 30 + 180 * slide(Pattern("speckle", 4.0, 0.5, 5), 400)


def sheared(offset: RowOffset, disparity: float) -> tuple[np.ndarray, np.ndarray]:
    """A fronto-parallel pair whose right rows lie lower by the offset."""
    texture = speckle().astype(np.float32)
    left = texture[20 : 20 + H, 40 : 40 + W]
    y, x = np.indices((H, W), dtype=np.float32)
    lower = offset.over((H, W)).astype(np.float32)
    right = cv2.remap(texture, x + 40 + disparity, y + 20 - lower, cv2.INTER_LANCZOS4)
    return left, right


def poor(rows: int, rotation_rad: float = 3e-4, limit: float = 0.4) -> Rig:
    """The small rig with a poor calibration."""
    path = list_rigs()["mini"]
    spec = read_spec(path)
    error = spec.error.model_copy(
        update={"rotation_rad": rotation_rad, "principal_px": 0.5, "epipolar_limit_px": limit}
    )
    asked = spec.reconstruction.model_copy(update={"rows": rows})
    return build_rig("poor", spec.model_copy(update={"error": error, "reconstruction": asked}), 3)


def ball(rig: Rig) -> Scan:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.018)
    settings = replace(settings_for(rig), colour=False)
    return scan(mesh, rig, rng=stream(0, "sample", 0, 0, "scan"), settings=settings)


@pytest.mark.parametrize("middle", [-3.2, -0.4, 0.0, 1.7])
def test_reference_a_known_offset_is_found(middle: float) -> None:
    made = RowOffset(middle, 0.15, -0.2, 0)
    left, right = sheared(made, 7.0)
    found = find_row_offset(left, right, (-10, 20), SEARCH)
    assert found is not None
    assert found.middle == pytest.approx(middle, abs=0.03)
    assert found.across == pytest.approx(0.15, abs=0.04)
    assert found.down == pytest.approx(-0.2, abs=0.04)
    assert found.windows > 100


def test_reference_reading_further_down() -> None:
    """The right view read lower by a whole row is the view, moved by that row."""
    rig = load_rig("mini")
    pair = rectify(rig.units[0].nominal.left, rig.units[0].nominal.right)
    h, w = pair.camera.height, pair.camera.width
    raw = speckle()[:h, :w].astype(np.float32)
    _, plain = rectify_images(pair, (raw, raw))
    left, lower = rectify_images(pair, (raw, raw), np.ones((h, w)))
    assert np.array_equal(left, rectify_images(pair, (raw, raw))[0])
    inner = slice(20, h - 20), slice(20, w - 20)
    difference = lower[inner] - np.roll(plain, -1, axis=0)[inner]
    assert np.abs(difference).mean() < 0.05


def test_properties_a_poor_calibration_is_matched_again() -> None:
    trusted, searched = (ball(poor(rows, limit=20.0)) for rows in (0, 4))
    assert max(u["epipolar_rms_px"] for u in searched.report["units"].values()) > 1.0
    lost, found = (
        sum(u["matched"] for u in s.report["units"].values()) for s in (trusted, searched)
    )
    assert found > 1.25 * lost
    lit = sum(u["lit"] for u in searched.report["units"].values())
    assert found > 0.9 * lit
    assert any("rows were put right" in note for note in searched.report["notes"])
    assert not any("rows were put right" in note for note in trusted.report["notes"])


def test_properties_no_draw_is_lost_where_rows_are_searched() -> None:
    assert poor(0).draws > 1
    rig = poor(6)
    assert rig.draws == 1
    assert rig.error.epipolar_limit_px == 3.0
    assert 0.4 < max(rig.epipolar_px) < 3.0


def test_reference_glass_moves_rows_by_a_known_amount() -> None:
    """The second unit's eyes look through the floor at different angles: 0.4 pixels."""
    rig = from_below(load_rig("mini"))
    assert rig.glass is not None
    points = volume_points(rig.volume_m, 5)
    points = points[points[:, 1] > rig.glass.top_m]
    for unit, apart in zip(rig.units, (0.0, 0.4), strict=True):
        eyes = unit.nominal.left, unit.nominal.right
        pair = rectify(*eyes)
        known = refracted_rows(pair, rig.glass, rig.volume_m)
        assert known is not None
        a, b = (
            rectified_pixels(pair, k, project_through(rig.glass, eye, points))
            for k, eye in enumerate(eyes)
        )
        off = (b - a)[:, 1]
        assert np.sqrt(np.mean(off**2)) == pytest.approx(apart, abs=0.05)
        column, row = np.clip(np.rint(b), 0, [255, 191]).astype(int).T
        assert np.abs(off - known.over((192, 256))[row, column]).max() < 0.1
    above = load_rig("mini").units[0].nominal
    straight = rectify(above.left, above.right)
    assert refracted_rows(straight, rig.glass, rig.volume_m) is None, "from above"
    assert refracted_rows(straight, None, rig.volume_m) is None


def test_properties_pairs_below_glass_match_as_well_as_others() -> None:
    rig = from_below(load_rig("mini"))
    exact = replace(rig, units=tuple(replace(u, true=u.nominal) for u in rig.units))
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.018)
    settings = replace(settings_for(exact), colour=False, true_disparity=True)
    found = scan(mesh, exact, rng=stream(0, "sample", 0, 0, "scan"), settings=settings)
    one, other = (pair_figures(unit).core_mm for unit in found.units)
    assert other < 1.5 * one


def test_edge_no_draw_is_good_enough() -> None:
    with pytest.raises(ConfigError, match=r"none of 200.*rows that do not correspond.*rows: \d"):
        poor(0, rotation_rad=1e-2)


def test_edge_nothing_to_find() -> None:
    dark = np.zeros((H, W), np.float32)
    assert find_row_offset(dark, dark, (-10, 20), SEARCH) is None
    left, right = sheared(RowOffset(0.0, 0.0, 0.0, 0), 7.0)
    assert find_row_offset(left, right, (-10, 20), MatchSettings()) is None
    assert find_row_offset(left, speckle()[:H, :W][::-1], (-10, 20), SEARCH) is None
