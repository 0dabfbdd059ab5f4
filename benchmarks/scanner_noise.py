"""Levels of the scanner against each other, and the fit of the noise model behind ``model``.

Two hands that the fit has not seen, of light and of dark skin, are scanned by one scanner at each
level. ``--rows fit`` fits the model to full residuals first and writes ``scenes/noise/``; do so
whenever matching has changed. Two CPU minutes; the fit takes another two.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.scanner_parts import setting
from benchmarks.scanner_parts.pictures import figure, scan_sheet
from synthgen.errors import ConfigError
from synthgen.scanner import Effects, Scan, ScanScene, UnitScan, load_rig, scaled
from synthgen.scanner.hand import HandSolid
from synthgen.scanner.match import DisparityGrid
from synthgen.scanner.noise import SHARES, mattness
from synthgen.scanner.noise_fit import fit_noise
from synthgen.scanner.pipeline import assemble, measure
from synthgen.scanner.range_grid import GridSettings, range_grid

FOLDER = Path(__file__).resolve().parents[1] / "scenes" / "noise"
LEVELS = ("full", "half", "model")
FIT, FITTED_RIGS = "fit", ("hand5", "consumer")
# Sample, spin, tone (0 is light) and scanner seed; compared hands are not those of the fit.
FITTED = ((0, 0.0, 0.1, 3), (12, 1.2, 0.4, 6), (5, 2.6, 0.7, 8), (9, 4.0, 1.0, 2))
COMPARED = ((3, 2.0, 0.15, 12), (6, 5.0, 0.85, 12))
FACING = ((0.25, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 1.0))
DEPTHS = ("near", "middle", "far")
WINDOWS = (0.5, 1.0, 2.0)
EVERYTHING = GridSettings(jump_px=5.0, bridge=0, erode=0, facing=0.05)


@dataclass(frozen=True, eq=False)
class Errors:
    """Depth errors of one unit's samples, millimetres, and what they may depend on.

    Attributes
    ----------
    error : (h, w)
        NaN where the sample was not matched.
    facing, depth : (h, w)
        Cosine to the line of sight, and depth in metres, of the true surface; NaN where it is
        not seen.
    spacing_px : float
        Between samples, pixels of a full picture.
    """

    error: Any
    facing: Any
    depth: Any
    spacing_px: float


def run(rows: Sequence[str] = (), pictures: Path = Path("out/scanner_noise")) -> dict[str, Any]:
    """Scan the hands at every level; ``rows`` may name levels, and ``fit``."""
    for name in rows:
        if name not in (FIT, *LEVELS):
            raise ConfigError(f"no level {name!r}; there are {', '.join(LEVELS)}, and {FIT}")
    levels = [level for level in LEVELS if level in rows] or list(LEVELS)
    pictures.mkdir(parents=True, exist_ok=True)
    with threadpool_limits(limits=1):
        written = [write(name) for name in FITTED_RIGS] if FIT in rows else []
        found = {level: _level(level, pictures) for level in levels}
    names = list(found[levels[0]])
    ratio = "full" in levels and "model" in levels
    _draw(found, pictures / "levels.png")
    return {
        "title": "hand5, two unseen hands (light, dark), geometry only; millimetres unless said",
        "columns": ["what", *levels, *(["model / full"] if ratio else [])],
        "rows": [
            [name, *(found[level][name] for level in levels),
             *([_ratio(found["model"][name], found["full"][name])] if ratio else [])]
            for name in names
        ],
        "notes": [
            "residual: depth measured minus ideal, every matched sample; robust standard deviation",
            "correlation: of residuals half a window (6.5 px), one and two windows apart",
            f"pictures: {pictures}",
            *(f"fitted: {path}" for path in written),
        ],
    }  # fmt: skip


def _ratio(a: float, b: float) -> float | str:
    return a / b if b else ""


def _level(level: Any, pictures: Path) -> dict[str, float]:
    """Figures of one level: fused ones, means over the hands, and residuals of all units."""
    fused, errors, spent = [], [], 0.0
    for number, case in enumerate(COMPARED):
        begun = time.process_time()
        found, parts = _scanned(level, *case)
        spent += time.process_time() - begun
        fused.append(_fused(found, case))
        errors += [_errors(unit) for unit in parts if np.isfinite(unit.disparity).any()]
        scan_sheet(found, pictures / f"{level}_{number}.png")
    mean = {name: float(np.mean([f[name] for f in fused])) for name in fused[0]}
    each = {f"RMS, {skin} skin": f["RMS"] for skin, f in zip(("light", "dark"), fused, strict=True)}
    return mean | each | _residuals(errors) | {"CPU s a scan": spent / len(COMPARED)}


def _scanned(
    level: Any, sample: int, spin: float, tone: float, seed: int
) -> tuple[Scan, list[UnitScan]]:
    """Scan a hand by the scanner of a seed, everything on."""
    rig = load_rig("hand5", seed)
    asked = setting.settings(rig, level)
    solid = _hand(sample, spin, tone).solid
    used = scaled(rig, 0.5) if level == "half" else rig
    stage = setting.staged([solid], used, sample, Effects())
    parts = [measure(stage, unit, level, asked) for unit in used.units]
    return assemble(parts, ScanScene((solid,)), level, asked), [part.unit for part in parts]


def _hand(sample: int, spin: float, tone: float) -> HandSolid:
    asked = [f"skin.tones=[{tone},{tone}]"]
    return setting.hand(sample, spin, asked, flat=False)


def _fused(found: Scan, case: tuple[int, float, float, int]) -> dict[str, float]:
    held, rig = _hand(*case[:3]), load_rig("hand5", case[3])
    seen, invented = setting.covered(found, setting.staged([held.solid], rig), held, rig)
    error = 1e3 * found.provenance["error_m"]
    return {
        "RMS": setting.fused_rms(found),
        "bias (median)": float(np.median(error)),
        "95 % of |error|": float(np.quantile(np.abs(error), 0.95)),
        "share > 1 mm": float((np.abs(error) > 1).mean()),
        "vertices, thousands": len(found.vertices) / 1e3,
        "seen surface covered": seen,
        "never-seen surface invented": invented,
    }


def _errors(unit: UnitScan) -> Errors:
    assert unit.true_disparity is not None
    true = unit.true_disparity
    shape = unit.pair.camera.height, unit.pair.camera.width
    ideal = DisparityGrid(true, np.ones_like(true), np.ones_like(true), unit.step, shape)
    grid = range_grid(unit.pair, ideal, EVERYTHING)
    found, depth = (unit.pair.depth(d.astype(np.float64)) for d in (unit.disparity, true))
    full = load_rig("hand5").units[0].nominal.left.width / shape[1]
    return Errors(1e3 * (found - depth), grid.facing, depth, unit.step * full)


def _residuals(errors: list[Errors]) -> dict[str, float]:
    """Deviation and matched share by view angle and depth, and correlation over windows."""
    error, facing, depth = (
        np.concatenate([getattr(e, name).ravel() for e in errors])
        for name in ("error", "facing", "depth")
    )
    matched = np.isfinite(error)
    found = {"matched, of what both cameras see": float(matched[np.isfinite(depth)].mean()),
             "residual": _deviation(error)}  # fmt: skip
    for low, high in FACING:
        own = (facing > low) & (facing <= high)
        found[f"residual, view cosine {low}-{high}"] = _deviation(error[own])
        found[f"matched, view cosine {low}-{high}"] = float(matched[own].mean())
    edges = np.nanquantile(depth, [0, 1 / 3, 2 / 3, 1])
    for name, low, high in zip(DEPTHS, edges[:-1], edges[1:], strict=True):
        found[f"residual, {name} third"] = _deviation(error[(depth >= low) & (depth <= high)])
    for windows in WINDOWS:
        found[f"correlation, {windows:g} windows apart"] = _correlation(errors, 13 * windows)
    return found


def _deviation(error: Any) -> float:
    return 1.4826 * float(np.nanmedian(np.abs(error)))


def _correlation(errors: list[Errors], apart_px: float) -> float:
    """Autocorrelation of residuals, clipped at half a millimetre, where the surface faces."""
    products, squares = [], []
    for e in errors:
        lag = max(1, round(apart_px / e.spacing_px))
        c = np.clip(np.where(e.facing > 0.5, e.error, np.nan), -0.5, 0.5)
        products += [(c[:, lag:] * c[:, :-lag]).ravel(), (c[lag:] * c[:-lag]).ravel()]
        squares.append((c * c).ravel())
    return float(np.nanmean(np.concatenate(products)) / np.nanmean(np.concatenate(squares)))


def _draw(found: dict[str, dict[str, float]], path: Path) -> None:
    made = figure(11, 4)
    for k, (title, kind) in enumerate((("residual, mm", "residual, view cosine"),
                                       ("matched share", "matched, view cosine"),
                                       ("correlation", "correlation"))):  # fmt: skip
        axes: Any = made.add_subplot(1, 3, k + 1)
        for level, figures in found.items():
            own = {name: value for name, value in figures.items() if name.startswith(kind)}
            words = [name.removeprefix(kind).strip(" ,").removesuffix(" apart") for name in own]
            axes.plot(words, list(own.values()), "o-", label=level)
        axes.set(title=title, ylim=(0, None))
        axes.legend()
    made.savefig(path, dpi=110)


def write(name: str = "hand5") -> Path:
    """Fit the model to scans of four hands of all tones by four scanners, and write it."""
    pairs, matt, step = [], [], 1
    for sample, spin, tone, seed in FITTED:
        rig = load_rig(name, seed)
        solid = _hand(sample, spin, tone).solid
        stage = setting.staged([solid], rig, sample, Effects())
        asked = replace(setting.settings(rig), truth=False)
        for unit in rig.units:
            part = measure(stage, unit, "full", asked).unit
            if np.isfinite(part.disparity).any() and part.true_disparity is not None:
                pairs.append((part.disparity, part.true_disparity))
                matt.append(mattness(solid.surface))
                step = part.step
    model = fit_noise(pairs, step, matt)
    count = sum(int(np.isfinite(measured).sum()) for measured, _ in pairs)
    lines = [f"# Fitted by benchmarks/scanner_noise.py to {count} samples of {len(pairs)} pairs of "
             f"{name}, level full: {len(FITTED)} hands,",
             f"# mattness {min(matt):.3f} to {max(matt):.3f}, scanner seeds "
             f"{', '.join(str(case[3]) for case in FITTED)}."]  # fmt: skip
    for key, value in model.model_dump().items():
        if key == "errors_px":
            lines.append(f"{key}:  # at {', '.join(f'{share:g}' for share in SHARES)}")
            lines += [f"  - {list(law)}" for law in value]
        else:
            lines.append(f"{key}: {list(value) if isinstance(value, tuple) else value}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / f"{'consumer' if rig.reconstruction.matcher == 'census' else name}.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
