"""Tests of one stereo pair on targets with known surfaces: T1, T2, T3, T5, T6, T8."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.scanner_parts import setting
from benchmarks.scanner_parts.pictures import error_maps, scan_sheet
from benchmarks.scanner_parts.rows import Row, row
from benchmarks.scanner_parts.targets import ball, cylinders, plate
from synthgen.geometry.normals import unit
from synthgen.scanner import ScanScene, UnitScan
from synthgen.scanner.evaluate import pair_figures, predicted_sigma
from synthgen.scanner.exposure import digitised, speckle_radiance
from synthgen.scanner.match import FAST, match
from synthgen.scanner.pipeline import assemble, disparity_bounds
from synthgen.scanner.range_grid import triangulate
from synthgen.scanner.rectify import rectify, rectify_images
from synthgen.scanner.rig import Sensor
from synthgen.scanner.sensor import automatic_gain, optical

PATTERNS, NOISE_DRAWS = 16, 8
GAPS_MM = (0, 1, 2, 3, 5, 10)


def planes(pictures: Path) -> list[Row]:
    """T1: a plate at 0, 30 and 55 degrees."""
    rig, rows, shown = setting.rig(units=["front"]), [], []
    for tilt, rms in ((0, 0.05), (30, 0.05), (55, 0.06)):
        _, part = setting.front([plate(rig, (0.06, 0.06, 0.004), (0, 0, 0), tilt)], rig)
        f = pair_figures(part.unit)
        shown.append((f"plane at {tilt} deg", part.unit))
        rows += [
            row(f"T1 plane {tilt} deg: core RMS", f.core_mm, None, rms, own=True),
            row(f"T1 plane {tilt} deg: |bias|", abs(f.bias_mm), None, 0.01, own=True),
            row(f"T1 plane {tilt} deg: fill", f.complete, 0.97, own=True),
        ]
    error_maps(shown, pictures / "T1_planes.png")
    return rows


def noise(_: Path) -> list[Row]:
    """T2: temporal noise of a plane against the Cramer-Rao bound."""
    pair, pictures, grids, sensor = _repeated(NOISE_DRAWS)
    mean = np.mean(pictures, axis=0)
    expected = predicted_sigma(mean, pixel_noise(sensor, mean), FAST.dic)[
        :: FAST.step, :: FAST.step
    ]
    spread = np.std(grids, axis=0, ddof=1)
    whole = np.isfinite(spread).astype(np.uint8)
    known = cv2.erode(whole, np.ones((7, 7), np.uint8)) > 0
    temporal = float(np.sqrt(np.mean(spread[known] ** 2)))
    bound = float(np.sqrt(np.mean(expected[known] ** 2)))
    depth = float(pair.depth(np.array(0.0)))
    per_px = 1e3 * depth**2 / (pair.camera.fx * pair.baseline_m)
    return [
        row("T2 temporal noise, px", temporal),
        row("T2 temporal noise", temporal * per_px),
        row("T2 temporal noise / Cramer-Rao bound", temporal / bound, 0.9, 1.3),
    ]


def _repeated(draws: int) -> Any:
    """Pair, left pictures (n, H, W), disparity grids (n, h, w) of a plane under new noise."""
    rig = setting.rig(units=["front"])
    (of,) = rig.units
    stage = setting.staged([plate(rig, (0.04, 0.04, 0.004), (0, 0, 0))], rig)
    sensor = rig.grey
    light = [optical(speckle_radiance(stage, of, role, spp=9), sensor, of.true.camera(role))
             for role in ("left", "right")]  # fmt: skip
    gain = automatic_gain(light, rig.light.background, sensor.auto_target) or 1.0
    pair = rectify(of.nominal.left, of.nominal.right)
    pictures, grids = [], []
    for draw in range(draws):
        stage.key = draw
        raw = [digitised(stage, of, role, picture, sensor, gain)
               for role, picture in zip(("left", "right"), light, strict=True)]  # fmt: skip
        left, right = rectify_images(pair, (raw[0], raw[1]))
        pictures.append(left)
        grids.append(match(left, right, disparity_bounds(rig, pair), FAST).disparity)
    return pair, pictures, grids, sensor


def pixel_noise(sensor: Sensor, mean: Any) -> Any:
    """Return the deviation of 8-bit pixels of a mean value: shot, read, quantisation noise."""
    per_dn = sensor.full_well_e / 255
    shot = np.maximum(mean - sensor.black_dn, 0) * per_dn
    return np.sqrt((shot + sensor.read_noise_e**2) / per_dn**2 + 1 / 12)


def spheres(pictures: Path) -> list[Row]:
    """T3: radial error of a finger-sized and a larger sphere where they face the pair."""
    rows, shown = [], []
    for radius, bound in ((0.009, 0.005), (0.025, None)):
        biases, forms = [], []
        for seed in range(PATTERNS):
            measured, error = sphere_error(radius, seed)
            biases.append(error.mean())
            forms.append(np.mean(error**2))
        shown.append((f"sphere r {1e3 * radius:.0f} mm", measured))
        name = f"T3 sphere r {1e3 * radius:.0f}, {PATTERNS} patterns"
        rows += [
            row(f"{name}: |convexity bias|", abs(float(np.mean(biases))), None, bound or 0.005,
                own=bound is None),
            row(f"{name}: sd of the bias", float(np.std(biases, ddof=1))),
            row(f"{name}: RMS", float(np.sqrt(np.mean(forms))), None, 0.05, own=True),
        ]  # fmt: skip
    error_maps(shown, pictures / "T3_spheres.png")
    return rows


def sphere_error(radius_m: float, seed: int) -> tuple[UnitScan, Any]:
    """Measure a sphere with one pattern: unit, radial errors (n,) mm at view cosines over 0.7."""
    rig = setting.rig(seed, ["front"])
    _, part = setting.front([ball(radius_m)], rig, seed)
    measured = part.unit
    d = measured.disparity.astype(np.float64)
    y, x = np.indices(d.shape) * measured.step
    points = triangulate(measured.pair, x, y, d)[np.isfinite(d)]
    sight = unit(measured.pair.left.position - points)
    facing = np.einsum("nk,nk->n", unit(points), sight) > 0.7
    return measured, 1e3 * (np.linalg.norm(points, axis=1) - radius_m)[facing]


def step_edge(pictures: Path) -> list[Row]:
    """T5: how far a near plate's depth reaches over its edges, and what is missing beside them."""
    rig = setting.rig(units=["front"])
    near = plate(rig, (0.03, 0.04, 0.002), (-0.01, 0, 0.01))
    far = plate(rig, (0.09, 0.05, 0.002), (0, 0, -0.005))
    _, part = setting.front([near, far], rig)
    measured, pair = part.unit, part.unit.pair
    d, true = measured.disparity, measured.true_disparity
    assert true is not None
    middle = float(pair.disparity(pair.depth(np.nanmedian(true)) - 0.004))
    seen = np.isfinite(true)
    crossed = (seen & (true > middle)).any(axis=1)
    # Beside the near plate is the far one: seen by both cameras, or hidden from one.
    wrong = (d > middle) & ~(true > middle)
    lost = seen & ~np.isfinite(d)
    per_row = measured.step * 1e3 * float(np.nanmedian(pair.depth(true))) / pair.camera.fx
    error_maps([("step of 15 mm", measured)], pictures / "T5_step.png")
    edges = 2 * crossed.sum()
    return [
        row("T5 step of 15 mm: fattening per edge", float(wrong[crossed].sum() / edges * per_row),
            None, 0.6, own=True),
        row("T5 step of 15 mm: unmatched per edge", float(lost[crossed].sum() / edges * per_row)),
    ]  # fmt: skip


def webbing(pictures: Path) -> list[Row]:
    """T6: two cylinders of 8 mm radius side by side: surface that bridges the gap."""
    rig, rows, shown = setting.rig(units=["front"]), [], []
    for gap in GAPS_MM:
        solids = cylinders(1e-3 * gap)
        _, part = setting.front(solids, rig)
        shown.append((f"gap {gap} mm", part.unit))
        found = assemble([part], ScanScene(tuple(solids)), "full", setting.settings(rig))
        outside = 1e3 * found.provenance["error_m"] > 0.5
        if gap == 1:
            scan_sheet(found, pictures / "T6_gap_1mm.png")
        rows.append(
            row(f"T6 gap {gap} mm: share of vertices outside by over 0.5", float(outside.mean()),
                None, 0.001 if gap else None, own=True)  # where they touch, it has to
        )  # fmt: skip
    error_maps(shown[:4], pictures / "T6_webbing.png")
    return rows


def motion(pictures: Path) -> list[Row]:
    """T8: a sphere that moves across: where it is put, with a global and a rolling shutter."""
    rows, shown = [], []
    cases = ((0.0, 0.0, 0.05), (0.3, 0.0, 0.1), (1.0, 0.0, None), (0.3, 1e-5, None))
    for speed, delay, bound in cases:
        rig = setting.rig(units=["front"])
        rig = replace(rig, grey=replace(rig.grey, line_delay_s=delay))
        moving = ball(0.015, velocity_m_s=np.array([speed, 0.0, 0.0]))
        _, part = setting.front([moving], rig)
        assert part.grid is not None
        error = 1e3 * (np.linalg.norm(part.grid.world_points(), axis=1) - 0.015)
        name = f"{speed:g} m/s{', rolling 10 us a row' if delay else ''}"
        shown.append((name, part.unit))
        rows.append(row(f"T8 sphere r 15 at {name}: RMS", float(np.sqrt(np.mean(error**2))), None,
                        bound, own=True))  # fmt: skip
        rows.append(row(f"T8 sphere r 15 at {name}: matched", pair_figures(part.unit).complete))
    error_maps(shown, pictures / "T8_motion.png")
    return rows
