"""Levels of the scanner against each other, and the fit of the noise model behind ``model``.

``python -m benchmarks.scanner_noise`` fits it to full residuals and writes ``scenes/noise/``.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

SPINS = (0.0, 1.2)
FOLDER = Path(__file__).resolve().parents[1] / "scenes" / "noise"


def run() -> dict[str, Any]:
    """Scan one hand at the three levels by the same scanner."""
    from synthgen.scanner import load_rig

    rig = load_rig("hand5", seed=3)
    rows = []
    for level in ("full", "half", "model"):
        begun = time.process_time()
        scan = _scanned(rig, level, spin=2.0)
        spent = time.process_time() - begun
        error = 1e3 * scan.provenance["error_m"]
        units = [_unit_figures(unit) for unit in scan.units]
        rows.append([
            level, spent, len(scan.vertices), float(np.sqrt(np.mean(np.clip(error, -2, 2) ** 2))),
            float(np.median(error)), float(np.quantile(np.abs(error), 0.95)),
            float((np.abs(error) > 1).mean()), *np.median(units, axis=0).tolist(),
        ])  # fmt: skip
    return {
        "title": "hand5, scanner seed 3, one hand, geometry only, at the three levels",
        "columns": ["level", "CPU s", "vertices", "RMS mm", "median mm", "p95 mm", "> 1 mm",
                    "matcher sigma px", "matched"],
        "rows": rows,
        "notes": ["matcher sigma: robust, measured minus ideal disparity, of the level's own "
                  "pixels; matched: share of what both cameras see"],
    }  # fmt: skip


def _scanned(rig: Any, level: Any, spin: float) -> Any:
    from synthgen.config import load_config
    from synthgen.sampling import stream
    from synthgen.sampling.draw import draw_sample
    from synthgen.scanner import ScanScene, scan, settings_for
    from synthgen.scanner.hand import hand_solid, put_in_rig

    subject = draw_sample(load_config("hand_rgbd", []), int(10 * spin)).scene.subjects[0]
    solid = hand_solid(put_in_rig(subject, spin)).solid
    settings = replace(settings_for(rig, level), colour=False, true_disparity=True)
    rng = stream(0, "sample", int(10 * spin), 0, "scan")
    return scan(ScanScene((solid,)), rig, rng=rng, level=level, settings=settings)


def _unit_figures(unit: Any) -> list[float]:
    error = unit.disparity - unit.true_disparity
    both = np.isfinite(error)
    return [
        float(1.4826 * np.median(np.abs(error[both]))),
        float(both.sum() / np.isfinite(unit.true_disparity).sum()),
    ]


def write(name: str = "hand5") -> Path:
    """Fit the model to scans of two hands and write it."""
    from synthgen.scanner import load_rig
    from synthgen.scanner.noise_fit import fit_noise

    rig = load_rig(name, seed=0)
    units = [unit for spin in SPINS for unit in _scanned(rig, "full", spin).units]
    pairs = [(u.disparity, u.true_disparity) for u in units if np.isfinite(u.disparity).any()]
    model = fit_noise(pairs, units[0].step)
    count = sum(int(np.isfinite(measured).sum()) for measured, _ in pairs)
    lines = [f"# Fitted by benchmarks/scanner_noise.py to {count} samples of {len(pairs)} pairs of "
             f"{name}, level full."]  # fmt: skip
    for key, value in model.model_dump().items():
        shown = list(value) if isinstance(value, tuple) else value
        lines.append(f"{key}: {shown}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / f"{'consumer' if rig.reconstruction.matcher == 'census' else name}.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    for rig_name in sys.argv[1:] or ["hand5", "consumer"]:
        sys.stdout.write(f"{write(rig_name)}\n")
