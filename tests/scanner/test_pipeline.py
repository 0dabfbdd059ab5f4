"""scan() from mesh to scan with the smallest rig, and what it says when something is wrong."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from synthgen.errors import ConfigError, ScanError, ShapeError
from synthgen.sampling.streams import stream
from synthgen.scanner import (
    Scan,
    ScanScene,
    Surface,
    list_rigs,
    load_rig,
    scaled,
    scan,
    settings_for,
    solid_from_mesh,
)
from synthgen.scanner.evaluate import (
    coverage,
    pair_figures,
    predicted_sigma,
    seen_by_pairs,
    surface_samples,
)
from synthgen.scanner.match import FAST
from synthgen.scanner.pipeline import depth_bounds, disparity_bounds
from synthgen.scanner.rectify import rectify
from synthgen.scanner.rig import Rig
from synthgen.scanner.stage import prepare

BALL = trimesh.creation.icosphere(subdivisions=5, radius=0.018)


def scanned(rig: Rig, level: Any = "full", mesh: Any = BALL, **changes: Any) -> Scan:
    settings = replace(settings_for(rig, level), true_disparity=True, **changes)
    rng = stream(0, "sample", 0, 0, "scan")
    return scan(mesh, rig, rng=rng, level=level, settings=settings)


@pytest.fixture(scope="module")
def full() -> Scan:
    return scanned(load_rig("mini"))


def test_smoke_ball(full: Scan) -> None:
    assert full.problem is None
    assert len(full.vertices) > 400
    radius = np.linalg.norm(full.vertices, axis=1)
    assert np.sqrt(np.mean((radius - 0.018) ** 2)) < 0.0006
    assert full.provenance["error_m"] == pytest.approx(radius - 0.018, abs=3e-5)
    assert set(np.unique(full.provenance["unit"])) == {0, 1}
    assert (full.provenance["colour_unit"] >= 0).mean() > 0.8
    mean = full.colors[full.provenance["colour_unit"] >= 0].mean(axis=0)
    assert mean[0] > mean[1] > mean[2], "the default skin is reddish"
    assert full.texture.shape[2] == 3


def test_properties_the_report_tells_what_was_done(full: Scan) -> None:
    report = full.report
    assert report == json.loads(json.dumps(report, allow_nan=False))
    assert report["notes"] == []
    assert set(report["units"]) == {"front", "right"}
    for unit in full.units:
        told = report["units"][unit.ident]
        assert told["problem"] is None
        assert told["matched"] == np.isfinite(unit.disparity).sum()
        assert 0 < told["kept"] < told["matched"] <= 1.1 * told["lit"]
        assert told["searched_px"][0] <= told["found_px"][0] < told["found_px"][1]
        assert told["row_offset"] is None
        assert told["lit_by"] == ["front/0", "right/0"]


def test_properties_pairs_are_measured_well(full: Scan) -> None:
    for unit in full.units:
        figures = pair_figures(unit)
        assert figures.complete > 0.7
        assert figures.core_mm < 0.5
        assert abs(figures.bias_mm) < 0.2
    with pytest.raises(ScanError, match="unit front has no true disparities"):
        pair_figures(replace(full.units[0], true_disparity=None))


def test_properties_same_seed_same_bytes(full: Scan) -> None:
    again = scanned(load_rig("mini"))
    for name in ("vertices", "faces", "colors", "texture", "corner_uv"):
        assert getattr(again, name).tobytes() == getattr(full, name).tobytes(), name
    assert again.units[0].disparity.tobytes() == full.units[0].disparity.tobytes()


def test_properties_level_model_takes_no_pictures(full: Scan) -> None:
    found = scanned(load_rig("mini"), "model")
    assert found.units[0].left is None
    assert 0.5 < len(found.vertices) / len(full.vertices) < 1.5
    assert np.abs(np.median(found.provenance["error_m"])) < 0.0005


def test_properties_coverage_counts_what_is_there(full: Scan) -> None:
    points, normals, areas = surface_samples(np.asarray(BALL.vertices), np.asarray(BALL.faces))
    assert areas.sum() == pytest.approx(BALL.area)
    assert normals == pytest.approx(BALL.face_normals, abs=1e-6)
    rig = load_rig("mini")
    stage = prepare(BALL, rig, rng=stream(0, "sample", 0, 0, "stage"))
    seen = seen_by_pairs(stage, rig.units, points, normals)
    assert 0.3 < seen.mean() < 0.8
    there, invented = coverage(full, points, areas, seen, 0.002)
    assert there > 0.8
    assert invented < 0.2
    half = np.where(points[:, 1] > 0, areas, 0)
    assert coverage(full, points, half, seen, 0.002)[0] != there
    assert coverage(full, points, areas, np.ones_like(seen), 10.0) == (1.0, 0.0)


def test_reference_predicted_sigma_of_a_ramp() -> None:
    ramp = np.tile(np.arange(60.0) * 3, (60, 1))
    sigma = predicted_sigma(ramp, np.full(ramp.shape, 2.0), FAST.dic)
    w = np.outer(FAST.dic.weights, FAST.dic.weights)
    expected = np.sqrt(2 * 4 * (w**2).sum() * 9) / (w.sum() * 9)
    assert sigma[30, 30] == pytest.approx(expected, rel=1e-6)


def test_edge_dark_projectors_are_told_by_unit() -> None:
    rig = load_rig("mini")
    dark = replace(rig, projectors=tuple(replace(p, irradiance=0.0) for p in rig.projectors))
    found = scanned(dark)
    assert len(found.vertices) == 0
    assert found.problem is not None
    assert "unit front" in found.problem and "unit right" in found.problem
    assert all(unit.problem for unit in found.units)
    assert found.problem.count("unit front") == 1
    assert "projector front/0 lights nothing of the subject" in found.report["notes"]
    unpictured = scanned(dark, "model")
    assert "unit right: black speckle: projectors front/0, right/0" in str(unpictured.problem)


def test_edge_the_inverse_square_trap_is_told() -> None:
    """Irradiance given as if it did not fall with the distance; in the dark it leaves black."""
    rig = load_rig("mini")
    weak = replace(rig, projectors=tuple(replace(p, irradiance=1e-7) for p in rig.projectors))
    for ambient in (0.05, 0.0):
        found = scanned(replace(weak, light=replace(rig.light, ambient=ambient)), colour=False)
        for unit in ("front", "right"):
            assert re.search(rf"unit {unit}: black speckle: .* give [\d.]+e-07", str(found.problem))


def test_properties_saturation_and_what_it_costs_can_be_left_out(
    full: Scan, tmp_path: Path
) -> None:
    """Exposed two and a half times too long; the file of a rig has the switches."""
    text = list_rigs()["mini"].read_text(encoding="utf-8")
    errors = {}
    for switches in ("", ", saturation: false", ", saturation: false, quantisation: false"):
        path = tmp_path / "mini.yaml"
        path.write_text(f"{text}grey_sensor: {{auto_target: 2.0{switches}}}\n", encoding="utf-8")
        found = scanned(load_rig(path), colour=False)
        white = [unit["saturated"] for unit in found.report["units"].values()]
        assert all((share == 0) == bool(switches) for share in white)
        errors[switches] = np.sqrt(np.mean(found.provenance["error_m"] ** 2))
    usual = np.sqrt(np.mean(full.provenance["error_m"] ** 2))
    burnt, *others = errors.values()
    assert burnt > 1.1 * usual
    assert others == pytest.approx([usual] * 2, rel=0.03)


def test_edge_what_is_wrong_with_the_pictures_is_said() -> None:
    rig = load_rig("mini")
    white = scanned(replace(rig, grey=replace(rig.grey, gain=500.0)), colour=False)
    assert "unit right: the picture is overexposed" in str(white.problem)
    turned = trimesh.Trimesh(BALL.vertices, BALL.faces[:, ::-1], process=False)
    assert "counter-clockwise seen from outside" in str(scanned(rig, mesh=turned).problem)
    alone = replace(rig, units=(rig.units[0], replace(rig.units[1], slot=3)))
    half = scanned(alone, colour=False)
    assert half.problem is None
    assert half.units[0].problem is None
    assert "projectors (none in its slot 3) give 0" in str(half.units[1].problem)


def test_edge_wrong_use() -> None:
    rig = load_rig("mini")
    with pytest.raises(ShapeError, match=r"numpy\.random\.default_rng"):
        scan(BALL, rig, rng=0)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="square numbers"):
        scanned(rig, spp=5)
    with pytest.raises(ConfigError, match="levels are full"):
        scan(BALL, rig, rng=stream(0, "sample", 0, 0, "scan"), level="best",  # type: ignore[arg-type]
             settings=settings_for(rig))  # fmt: skip
    with pytest.raises(ScanError, match=r"left camera .* inside solid 0.* in metres"):
        scanned(rig, mesh=BALL.copy().apply_scale(1000))
    around = BALL.vertices + rig.units[0].true.left.position
    with pytest.raises(ScanError, match=r"unit front: the left camera .* inside solid 0"):
        scanned(rig, mesh=trimesh.util.concatenate(
            [BALL, trimesh.Trimesh(around, BALL.faces[:, ::-1], process=False)]))  # fmt: skip


def test_edge_numbers_that_are_out_of_range() -> None:
    rig = load_rig("mini")
    usual = settings_for(rig)
    with pytest.raises(ConfigError, match=r"match\.step = 500; 1 to 16"):
        scanned(rig, match=replace(usual.match, step=500))
    with pytest.raises(ConfigError, match=r"fusion\.voxel_m = 0\.0; 1e-05 to 0\.1"):
        scanned(rig, fusion=replace(usual.fusion, voxel_m=0.0))
    with pytest.raises(ConfigError, match=r"scaled by 0\.01: 192 pixels would be 1\.92"):
        scaled(rig, 0.01)
    with pytest.raises(ConfigError, match="a camera needs 16"):
        scaled(rig, -1)


def test_edge_a_scene_that_is_no_scene() -> None:
    rig, solid = load_rig("mini"), solid_from_mesh(BALL)
    for change, words in {
        "albedo": (Surface(albedo=np.nan), r"solid 1: surface\.albedo = nan; 0 to 1"),
        "rgb": (Surface(rgb=(0.5, 2.0, 0.5)), r"surface\.rgb = \(0\.5, 2\.0, 0\.5\)"),
        "subsurface_m": (Surface(subsurface_m=-1.0), r"surface\.subsurface_m = -1"),
    }.values():
        with pytest.raises(ShapeError, match=words):
            scanned(rig, mesh=ScanScene((solid, replace(solid, surface=change))))
    with pytest.raises(ShapeError, match=r"solid 0: vertex 3 is \[0\.0, inf, 0\.0\]"):
        torn = solid.vertices.copy()
        torn[3] = 0, np.inf, 0
        scanned(rig, mesh=ScanScene((replace(solid, vertices=torn),)))
    with pytest.raises(ShapeError, match="no faces; there is nothing to scan"):
        scanned(rig, mesh=trimesh.Trimesh())


def test_edge_too_little_for_a_surface_is_told_by_unit() -> None:
    """Nothing went wrong in any unit, and still there is no scan: how much did each measure?"""
    found = scanned(load_rig("mini"), mesh=trimesh.creation.icosphere(radius=0.004))
    assert len(found.vertices) == 0
    assert found.problem is not None
    assert "least_faces" in found.problem
    assert re.search(r"unit front: measured \d+ points; unit right: measured \d+", found.problem)


def test_edge_too_small_a_disparity_range_is_told() -> None:
    rig = load_rig("mini")
    near = replace(rig, volume_m=(0.004, 0.004, 0.004))
    low, high = disparity_bounds(
        near, rectify(rig.units[0].nominal.left, rig.units[0].nominal.right)
    )
    assert high - low < 4
    plate = trimesh.creation.box((0.05, 0.05, 0.002)).apply_translation((0, 0, 0.03))
    speck = trimesh.creation.icosphere(radius=0.001)
    found = scanned(near, mesh=trimesh.util.concatenate([plate, speck]))
    told = [unit.problem for unit in found.units if unit.problem]
    assert any("disparity range is too small" in text for text in told)


def test_edge_cameras_that_look_past_each_other_are_told(tmp_path: Path) -> None:
    text = list_rigs()["mini"].read_text()
    path = tmp_path / "parallel.yaml"
    path.write_text(text.replace("baseline_m: 0.12", "baseline_m: 0.12\n  axes: parallel"))
    found = scanned(load_rig(path), colour=False)
    assert "unit right: its two cameras see no part of the working volume together" in str(
        found.problem
    )


@pytest.mark.parametrize("matcher", ["sgbm", "census"])
def test_edge_units_nearer_than_two_baselines(matcher: str, tmp_path: Path) -> None:
    near = list_rigs()["mini"].read_text().replace("distance_m: 0.6", "distance_m: 0.2")
    path = tmp_path / "near.yaml"
    path.write_text(near.replace("matcher: sgbm", f"matcher: {matcher}"))
    rig = load_rig(path)
    for unit in rig.units:
        pair = rectify(unit.nominal.left, unit.nominal.right)
        low, high = disparity_bounds(rig, pair)
        assert low < float(pair.disparity(depth_bounds(rig, pair)[1] - 0.05)) < high
    found = scanned(rig, colour=False)
    assert all(u["matched"] > 500 for u in found.report["units"].values())


def test_edge_outside_the_volume() -> None:
    away = BALL.copy().apply_translation((1.0, 0, 0))
    with pytest.raises(ScanError):
        scanned(load_rig("mini"), mesh=away)


def test_edge_unknown_level() -> None:
    with pytest.raises(ConfigError, match="levels are full, half, model"):
        settings_for(load_rig("mini"), "quarter")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("part", "name", "value", "words"),
    [
        ("fusion", "voxel_m", 0.0, "1e-05 to 0.1"),
        ("fusion", "truncation", 0.5, "1 to 20"),
        ("match", "step", 0, "1 to 16"),
        ("match", "block", 8, "odd numbers"),
        ("match", "seed_scale", 4, "1 or 2"),
        ("match.dic", "window", 12, "odd numbers"),
        ("match.dic", "window", 1, "3 to 101"),
        ("match.dic", "order", 3, "1 or 2"),
        ("match.dic", "iterations", 0, "1 to 1000"),
        ("grid", "bridge", -1, "0 to 100"),
    ],
)
def test_edge_settings_that_give_no_scan(part: str, name: str, value: Any, words: str) -> None:
    settings = settings_for(load_rig("mini"))
    changed: Any = {name: value}
    if part == "match.dic":
        changed = {"dic": replace(settings.match.dic, **changed)}
    section = part.partition(".")[0]
    with pytest.raises(ConfigError, match=rf"{part}\.{name} = {value}; {words}"):
        replace(settings, **{section: replace(getattr(settings, section), **changed)})
    with pytest.raises(ConfigError, match=r"fill_voxels = -1\.0; 0 to 100"):
        replace(settings, fill_voxels=-1.0)
