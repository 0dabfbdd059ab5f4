"""The round trip of scan corpora, in the model and with shape that the model cannot express.

Not an inverse crime: ``skin.relief_m`` raises tendons, knuckles, wrist bones, webs and veins on the
drawn surface, which no shape or pose of the model has; scans see them, the fit lacks them. The same
hands, poses and scanner are used with and without. Level ``model`` of the scanner: its fitted
noise, no pictures. A sample costs about ten CPU seconds.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import igl
import numpy as np
from scipy.spatial import cKDTree

from synthgen.config import load_config
from synthgen.corpus import open_corpus
from synthgen.corpus.runner import generate
from synthgen.registration import fit
from synthgen.scene.relief import relief_of
from synthgen.verify import verify
from synthgen.verify.roundtrip import CURVED, HandTrip, round_trip
from synthgen.verify.stand_in import drawn_hand

SAMPLES = 6
MODES = {"in-model": 0.0, "1mm": 0.001, "2mm": 0.002}
SMALL = ("render.width=128", "render.height=128", "render.spp=1", "scanner.level=model",
         "corpus.columns=[image,depth,labels,meta,scan]")  # fmt: skip


def run(rows: tuple[str, ...] = (), samples: int = SAMPLES) -> dict[str, Any]:
    """Make one corpus per mode (or only those named) and take it back; one row each."""
    chosen = [name for name in MODES if not rows or name in rows]
    with tempfile.TemporaryDirectory(prefix="synthgen-") as folder:
        made = [row(name, Path(folder) / name, samples) for name in chosen]
    return {
        "title": f"round trip of {samples} hand scans from perturbed: relief that no model has",
        "columns": ["relief", "rms mm", "labels", "verdicts", "alarms", "vertices mm",
                    "seen vertices mm", "seen drawn surface mm", "same, coupled mm"],
        "rows": made,
        "notes": [
            "rms: of the relief. Vertices: fitted to true, of passed hands.",
            "Drawn surface: what was scanned, relief included; where a point lies within 2.5 mm.",
        ],
    }  # fmt: skip


def row(name: str, out: Path, samples: int) -> list[Any]:
    """Make, verify and fit one corpus."""
    asked = [*SMALL, f"samples={samples}", f"skin.relief_m={MODES[name]}"]
    generate(load_config("hand_scan", asked), out, progress=False)
    labels, trip = verify(out), round_trip(out, "perturbed")
    passed = [hand for hand in trip.trips if hand.verdict == "pass"]
    counts = ", ".join(f"{n} {verdict}" for verdict, n in trip.counts.items())
    surfaces = np.array([_surfaces(out, hand) for hand in passed]).reshape(-1, 3)
    mean = surfaces.mean(axis=0) if len(passed) else np.full(3, np.nan)
    v2v = [float(np.mean([hand.figures[key] for hand in passed])) if passed else float("nan")
           for key in ("v2v_mean_mm", "v2v_seen_mean_mm")]  # fmt: skip
    return [name, float(mean[0]), "ok" if labels.ok else f"{len(labels.failures)} failures", counts,
            trip.counts.get("truth_mismatch", 0), *v2v, float(mean[1]), float(mean[2])]  # fmt: skip


def _surfaces(out: Path, hand: HandTrip) -> tuple[float, float, float]:
    """RMS relief, and how far the seen drawn surface lies from the fit and a coupled fit, mm."""
    sample = open_corpus(out)[hand.sample]
    truth, scan, found = sample.subjects[hand.hand_number], sample.scan, hand.fit
    assert found is not None
    assert scan is not None
    heights = relief_of(truth.loaded, truth.description.skin, truth.pose)
    drawn, _ = drawn_hand(truth)
    points = scan.vertices.astype(np.float64)
    seen = drawn[cKDTree(points).query(drawn)[0] < 2.5e-3]
    start = (found.shape, found.pose, found.translation)
    coupled = fit(points, scan.normals.astype(np.float64), found.model, start, truth.hand,
                  curved=CURVED, coupled=True)  # fmt: skip
    free = found.vertices if coupled.free_vertices is None else coupled.free_vertices
    return (
        0.0 if heights is None else float(1e3 * np.sqrt(np.mean(heights**2))),
        _off(seen, found.vertices, found.model.faces),
        _off(seen, free, found.model.faces),
    )


def _off(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Mean distance of points from a mesh, millimetres."""
    mesh = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int64)
    return float(1e3 * np.sqrt(igl.point_mesh_squared_distance(points, *mesh)[0]).mean())
