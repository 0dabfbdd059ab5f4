"""The default error budget of hand5: term by term, and over twenty scanners.

A manufacturer's 0.2 mm RMS is a statement about scanners: each has its own frozen calibration
error. ``terms`` adds one error at a time to an exact scanner, ``sensors`` leaves what its sensors
add out, one at a time, ``geometry`` draws calibrations and motion without pictures, ``scanners``
scans one hand in full with twenty scanners. About twelve CPU minutes, most of it ``scanners``.

The hand's skin has the median tone of a corpus. It moves at 0.2 m/s, slowly; a hand that is held
still does so at a few centimetres per second. At 1 mm per exposure (0.67 m/s) units that fire
within half an exposure of one another see it up to a millimetre apart: a worst case, given beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.scanner_parts import setting
from benchmarks.scanner_parts.geometry import SeenPoints, fused_error_mm, seen_points, with_errors
from benchmarks.scanner_parts.pictures import figure, scan_sheet
from benchmarks.scanner_parts.rows import Row, row, run_tests
from synthgen.geometry.normals import unit
from synthgen.sampling import stream
from synthgen.scanner import Effects, Scan, ScanScene, load_rig, scan
from synthgen.scanner.rig import Rig
from synthgen.scanner.sensor import SENSOR_EFFECTS, without
from synthgen.scanner.subject import moved

SCANNERS, DRAWS = 20, 100
HAND_M_S, FAST_M_S = 0.2, 0.001 / 0.0015
MATT = {"specular": False, "subsurface": False, "defocus": False, "bounce": False}
LIGHT: dict[str, dict[str, bool]] = {
    "sensors, matching": MATT,
    "+ defocused projectors": MATT | {"defocus": True},
    "+ light below the skin": MATT | {"subsurface": True},
    "+ gloss": MATT | {"specular": True},
    "+ light between fingers": MATT | {"bounce": True},
    "all light": {},
}
CALIBRATION = ("focal", "principal_px", "rotation_rad", "translation_m")
NAMES = ("focal length", "principal point", "rotation", "baseline")


def run(rows: Sequence[str] = (), pictures: Path = Path("out/scanner_budget")) -> dict[str, Any]:
    """Run the parts that are named, or all, and draw what they found."""
    budget = _Budget()
    parts = {"terms": budget.terms, "sensors": budget.sensors, "geometry": budget.geometry,
             "scanners": budget.scanners}  # fmt: skip
    title = "hand5, one flat hand, fused RMS in millimetres (errors clipped at 2 mm)"
    with threadpool_limits(limits=1):
        table = run_tests(parts, rows, pictures, title)
    budget.draw(pictures / "budget.png")
    return table


class _Budget:
    """Collects what the parts find, for the picture."""

    def __init__(self) -> None:
        self.solid = setting.hand(1).solid
        self.alone: dict[str, float] = {}
        self.drawn: dict[str, Any] = {}
        self.values: list[float] = []

    def terms(self, _: Path) -> list[Row]:
        """Add light effects one at a time, each with exact calibration and a hand that is still."""
        for name, effects in LIGHT.items():
            self.alone[name] = setting.fused_rms(self._scan(setting.rig(), 0.0, 0, effects))
        of = replace(setting.rig(), sync_s=load_rig("hand5").sync_s)
        for speed in (HAND_M_S, FAST_M_S):
            found = [self._scan(of, speed, seed, MATT) for seed in range(3)]
            name = f"+ motion, {speed:.2g} m/s (mean of 3)"
            self.alone[name] = float(np.mean([setting.fused_rms(scan_) for scan_ in found]))
        return [row(f"exact, {name}", value) for name, value in self.alone.items()]

    def sensors(self, _: Path) -> list[Row]:
        """Leave out what sensors add, one at a time and all of it, before an exact still hand."""
        names = tuple(SENSOR_EFFECTS)
        rows = []
        for off in ((), *((name,) for name in names), names):
            value = setting.fused_rms(self._scan(without(setting.rig(), off), 0.0, 0, MATT))
            label = "none of it" if off == names else f"without {off[0]}" if off else "all of it"
            rows.append(row(f"exact, sensors, {label}", value))
        return rows

    def geometry(self, _: Path) -> list[Row]:
        """Draw calibrations and motion, and see what they do to perfectly matched points."""
        at = seen_points(self.solid)
        error = load_rig("hand5").error
        sigmas = {name: float(getattr(error, name)) for name in CALIBRATION}
        for label, name in zip(NAMES, CALIBRATION, strict=True):
            self._draw_of(label, at, {name: sigmas[name]})
        self._draw_of("calibration, all", at, sigmas)
        for speed in (HAND_M_S, FAST_M_S):
            still = setting.rig()
            rms = [fused_error_mm(still, at, self._shifts(k, speed)) for k in range(DRAWS)]
            self.drawn[f"motion, {speed:.2g} m/s"] = rms
        rows = []
        for name, rms in self.drawn.items():
            low, middle, high = np.quantile(rms, [0.1, 0.5, 0.9])
            rows.append(row(f"geometry of {DRAWS} draws, {name}: median", float(middle)))
            rows.append([f"geometry, {name}: 10..90 %", f"{low:.3f}..{high:.3f}", "", ""])
        return rows

    def scanners(self, pictures: Path) -> list[Row]:
        """Scan the moving hand with twenty scanners, everything on, everything drawn."""
        for seed in range(SCANNERS):
            found = self._scan(load_rig("hand5", seed), HAND_M_S, seed, {})
            self.values.append(setting.fused_rms(found))
            if seed == 0:
                scan_sheet(found, pictures / "scanner_0.png")
        low, middle, high = np.quantile(self.values, [0.1, 0.5, 0.9])
        name = f"default budget, {SCANNERS} scanners, level full"
        return [
            row(f"{name}: median", float(middle), 0.17, 0.23),
            row(f"{name}: 10 % quantile", float(low)),
            row(f"{name}: 90 % quantile", float(high)),
            row(f"{name}: least", min(self.values)),
            row(f"{name}: largest", max(self.values)),
        ]

    def _scan(self, of: Rig, speed_m_s: float, seed: int, effects: dict[str, bool]) -> Scan:
        scene = ScanScene((self.solid,))
        if speed_m_s:
            x, y, z = (float(v) for v in speed_m_s * _way(seed))
            scene = moved(scene, (x, y, z))
        asked = setting.settings(of, true_disparity=False)
        return scan(scene, of, rng=setting.keyed(seed), settings=asked, effects=Effects(**effects))

    def _draw_of(self, label: str, at: SeenPoints, errors: dict[str, float]) -> None:
        self.drawn[label] = [fused_error_mm(with_errors(k, **errors), at) for k in range(DRAWS)]

    def _shifts(self, seed: int, speed_m_s: float) -> Any:
        """Return where each unit (5, 3) sees the hand, drawn as a scan's unit times are."""
        of = load_rig("hand5")
        late = stream(seed, "sample", 0, 0, "late").uniform(-of.sync_s, of.sync_s, len(of.units))
        return speed_m_s * late[:, None] * _way(seed)

    def draw(self, path: Path) -> None:
        """Draw bars of the single terms, and a dot for every scanner."""
        bars = self.alone | {f"{k} (geometry)": float(np.median(v)) for k, v in self.drawn.items()}
        made = figure(9, 1.5 + 0.32 * (len(bars) + 2 * bool(self.values)))
        axes: Any = made.add_subplot()
        axes.barh(range(len(bars)), bars.values(), color="#1f4e79")
        labels = list(bars)
        for k, rms in enumerate(self.drawn.values(), start=len(self.alone)):
            axes.plot(np.quantile(rms, [0.1, 0.9]), [k, k], color="#b5441c", linewidth=2)
        if self.values:
            k = len(labels)
            labels.append(f"{len(self.values)} scanners, everything")
            axes.plot(self.values, [k] * len(self.values), "o", color="#3b8132", alpha=0.6)
            axes.plot([np.median(self.values)], [k], "k|", markersize=22, markeredgewidth=2)
        axes.axvspan(0.17, 0.23, color="#dddddd", zorder=0)
        axes.set_yticks(range(len(labels)), labels)
        axes.set(xlabel="fused RMS, mm (grey: target of the median; red: 10..90 % of the draws)")
        axes.invert_yaxis()
        made.savefig(path, dpi=110)


def _way(seed: int) -> Any:
    return unit(stream(seed, "sample", 0, 0, "way").standard_normal(3))
