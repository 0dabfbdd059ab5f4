"""Tests of the whole scanner: T4 spacing, T7 a hand, what it costs, T9 green objects."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.scanner_parts import setting
from benchmarks.scanner_parts.pictures import error_maps, scan_sheet
from benchmarks.scanner_parts.rows import Row, row
from benchmarks.scanner_parts.targets import ball
from synthgen.scanner import Scan, ScanScene, is_green, scan, settings_for
from synthgen.scanner.evaluate import pair_figures
from synthgen.scanner.hand import HandSolid
from synthgen.scanner.match import BEST, match
from synthgen.scanner.pipeline import assemble, measure
from synthgen.scanner.rig import Rig
from synthgen.scanner.subject import GREEN

TONES, PANELS = (0.05, 0.5, 0.95), (5, 2)
BYTES_OF = ("vertices", "normals", "faces", "colors", "corner_uv", "texture")


def spacing(_: Path) -> list[Row]:
    """T4: distance of two spheres over all units, with exact and with default calibration."""
    radius, apart, rows = 0.012, 0.06, []
    centres = np.array([[-apart / 2, 0, 0], [apart / 2, 0, 0]])
    solids = tuple(ball(radius, c) for c in centres)
    for exact, bound in ((True, 0.02), (False, 0.2)):
        of = setting.rig(exact=exact)
        found = scan(ScanScene(solids), of, rng=setting.keyed(), settings=setting.settings(of))
        fitted = []
        for k, centre in enumerate(centres):
            own = found.vertices[found.provenance["solid"] == k].astype(np.float64)
            fit = least_squares(
                lambda c, own=own: np.linalg.norm(own - c, axis=1) - radius, centre,
                loss="soft_l1", f_scale=1e-4,
            )  # fmt: skip
            fitted.append(fit.x)
        error = 1e3 * abs(float(np.linalg.norm(fitted[1] - fitted[0])) - apart)
        name = f"T4 spheres 60 mm apart, {'exact' if exact else 'default'} calibration"
        rows.append(row(f"{name}: |spacing error|", error, None, bound, own=True))
    return rows


def hand(pictures: Path) -> list[Row]:
    """T7: a flat hand without added errors: pair, ``best``, matching time, fusion, holes."""
    of, held = setting.rig(), setting.hand()
    scene = ScanScene((held.solid,))
    stage = setting.staged([held.solid], of)
    asked = setting.settings(of, spp=9)
    parts = [measure(stage, unit, "full", asked) for unit in of.units]
    facing = max(parts, key=lambda p: int(np.isfinite(p.unit.disparity).sum())).unit
    f = pair_figures(facing)
    best = measure(stage, of.unit(facing.ident), "full", replace(asked, match=BEST)).unit
    b = pair_figures(best)
    rows = [
        row("T7 facing pair: core RMS", f.core_mm, None, 0.05),
        row("T7 facing pair: RMS with edges", f.all_mm, None, 0.10),
        row("T7 facing pair: outliers > 1 mm", f.outliers, None, 0.004),
        row("T7 facing pair: completeness", f.complete, 0.97),
        row("T7 best preset: core RMS", b.core_mm, None, 0.04),
        row("T7 best preset: RMS with edges", b.all_mm, None, 0.075),
        *(row(f"T7 seed + refinement at {count} disparities: CPU s", _match_s(facing, count), None,
              most) for count, most in ((80, 0.7), (170, 1.1))),
    ]  # fmt: skip
    error_maps([("default", facing), ("best", best)], pictures / "T7_pair.png")
    found = assemble(parts, scene, "full", asked)
    scan_sheet(found, pictures / "T7_fused_exact.png")
    return rows + fused_rows(found, stage, held, of)


def fused_rows(found: Scan, stage: Any, held: HandSolid, of: Rig) -> list[Row]:
    """Rows of a fused hand without added errors."""
    seen, invented = setting.covered(found, stage, held, of)
    error = 1e3 * found.provenance["error_m"]
    return [
        row("T7 fused, exact calibration: RMS", float(np.sqrt(np.mean(error**2))), None, 0.04),
        row("T7 fused: seen surface within 1 mm", seen, 0.90),
        row("T7 fused: never-seen surface invented", invented, None, 0.05),
        row("T7 fused: vertices, thousands", len(found.vertices) / 1e3, 50, 90),
    ]


def _match_s(of: Any, count: int) -> float:
    """CPU seconds of matching within ``count`` disparities around what is there, median of 3."""
    left, right = (picture.astype(np.float32) for picture in (of.left, of.right))
    low, high = np.nanmin(of.true_disparity), np.nanmax(of.true_disparity)
    middle = float(low + high) / 2
    bounds = middle - count / 2, middle + count / 2
    return statistics.median(
        _timed(lambda: match(left, right, bounds, settings_for(setting.rig()).match))[1]
        for _ in range(3)
    )


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    begun = time.process_time()
    result = work()
    return result, time.process_time() - begun


def cost(pictures: Path) -> list[Row]:
    """CPU seconds of a default scan after a first one, and whether the same seed gives the same."""
    of, scene = setting.rig(exact=False), ScanScene((setting.hand(1).solid,))

    def once(level: Any, colour: bool) -> Scan:
        asked = replace(settings_for(of, level), colour=colour, truth=False)
        return scan(scene, of, rng=setting.keyed(), level=level, settings=asked)

    first = once("half", True)  # compiles the kernels and makes the slides
    again = once("half", True)
    rows = [row("same seed, same bytes: half resolution, coloured", float(_same(first, again)), 1)]
    for level, colour, most in (("full", False, 28), ("full", True, 58), ("half", False, 9)):
        found, spent = _timed(lambda level=level, colour=colour: once(level, colour))
        rows.append(row(f"{level}{', colour' if colour else ''}: CPU s", spent, None, most))
        if colour:
            scan_sheet(found, pictures / "hand_full_colour.png")
    return rows


def _same(a: Scan, b: Scan) -> bool:
    pairs = [(getattr(a, name), getattr(b, name)) for name in BYTES_OF]
    pairs += [(a.provenance[name], b.provenance[name]) for name in a.provenance]
    pairs += [(u.disparity, v.disparity) for u, v in zip(a.units, b.units, strict=True)]
    return all(x.tobytes() == y.tobytes() for x, y in pairs)


def green(pictures: Path) -> list[Row]:
    """T9: the green-object rule over skin tones and lights."""
    rows = []
    for tone in TONES:
        for panels in PANELS:
            found = green_scan(tone, panels)
            recall, lost = green_shares(found)
            name = f"T9 tone {tone}, {panels} panels"
            rows += [row(f"{name}: green recall", recall, 0.99),
                     row(f"{name}: hand lost", lost, None, 0.01)]  # fmt: skip
            scan_sheet(found, pictures / f"T9_tone_{tone}_{panels}_panels.png")
    return rows


def green_scan(tone: float, panels: int) -> Scan:
    """Scan a hand of a skin tone (0 light, 1 dark) that touches a green ball, three units."""
    of = setting.rig(units=["front", "left", "right"], exact=False)
    of = replace(of, light=replace(of.light, white=of.light.white[:panels]))
    skin = setting.hand(2, asked=[f"skin.tones=[{tone},{tone}]"]).solid
    touching = skin.vertices[np.argmax(skin.vertices[:, 2])]
    held = ball(0.022, touching + [0, 0, 0.0215], GREEN)
    return scan(ScanScene((skin, held)), of, rng=setting.keyed(), level="half",
                settings=settings_for(of, "half"))  # fmt: skip


def green_shares(found: Scan) -> tuple[float, float]:
    """Share of the object's coloured vertices found green, and of the hand's."""
    green_ = is_green(found.colors)
    seen = found.provenance["colour_unit"] >= 0
    held = found.provenance["solid"] == 1
    return float(green_[held & seen].mean()), float(green_[~held & seen].mean())
