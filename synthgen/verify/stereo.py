"""Checks of a scan's rectified pairs: pictures, disparities, Q and calibration of every unit.

Witnesses that share no code with the scanner: the rig's file, plain matrix products, the true
surface through the true cameras with OpenCV's lens model, and the pictures themselves.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.config import load_config
from synthgen.corpus import Corpus
from synthgen.corpus.checksums import CONFIG
from synthgen.corpus.sample import Sample
from synthgen.errors import SynthgenError
from synthgen.geometry.cameras import Camera
from synthgen.scanner import Rig, Scan, load_rig, scaled
from synthgen.verify.disparities import check_disparity, check_pictures, check_true_disparity
from synthgen.verify.picture_place import check_measured_place, check_place
from synthgen.verify.report import Record, VerifyReport
from synthgen.verify.stand_in import drawn_hand
from synthgen.verify.stereo_pair import FEWEST, Pair

Array = NDArray[np.float64]

CALIBRATION, Q_M = 1e-9, 1e-7
SCAN_M = 1e-3  # and as far as the scan's vertices are apart


def rig_of(corpus: Corpus) -> Rig | str:
    """Load the scanner that made a corpus, or say why it is not known."""
    digest = corpus.manifest.get("rig_digest")
    if digest is None:
        return "the corpus has no scanner"
    try:
        scanner = load_config(str(corpus.path / CONFIG)).scanner
        rig = load_rig(str(scanner.rig), scanner.seed)
    except (SynthgenError, OSError) as error:
        return f"the rig is not found ({error})"
    return rig if rig.digest == digest else "the rig's file has changed since it scanned"


def check_stereo(report: VerifyReport, rig: Rig | str, sample: Sample) -> None:
    """Check every rectified pair of a sample's scan; none where the corpus stores no pairs.

    Parameters
    ----------
    report : VerifyReport
    rig : Rig or str
        The scanner, or why it is not known.
    sample : Sample
    """
    view = sample.views[0]
    if "stereo" not in view.columns or sample.scan is None:
        return
    facts = json.loads(view.stored_member("scan", f"{view.key}.scan.json"))
    scan = sample.scan.moved(np.linalg.inv(np.array(facts["T_world_from_rig"])))
    asked = {row["ident"] for row in facts["units"]}
    lost = asked ^ {unit.ident for unit in scan.units}
    report.measure(sample.index, -1, "stereo units", len(lost), 0,
                   f"no rectified pair is stored of {', '.join(sorted(lost))}")  # fmt: skip
    pairs = _pairs(scan, rig, sample, facts)
    for pair in pairs:
        record = Record(report, sample.index, about=f"unit {pair.stored.ident}: ")
        _check_calibration(record, pair)
        _check_Q(record, pair)
        check_true_disparity(record, pair)
        check_disparity(record, pair)
        check_measured_place(record, pair)
        check_pictures(record, pair)
        check_place(record, pair)
        _check_scan(record, pair)


def _pairs(scan: Scan, rig: Rig | str, sample: Sample, facts: dict[str, Any]) -> list[Pair]:
    T_world_from_rig, report = np.array(facts["T_world_from_rig"]), facts["report"]
    world, faces = drawn_hand(sample.subjects[0])
    vertices = (world - T_world_from_rig[:3, 3]) @ T_world_from_rig[:3, :3]

    def then(ident: str) -> Array:
        """Where the hand was when a unit exposed."""
        late = report["units"][ident]["time_s"]
        return np.asarray(vertices + late * np.array(report["velocity_m_s"]))

    used = scaled(rig, 0.5) if isinstance(rig, Rig) and scan.level == "half" else rig
    units = {unit.ident: unit for unit in used.units} if isinstance(used, Rig) else {}
    view, points = sample.views[0], cKDTree(scan.vertices)

    def stored_Q(ident: str) -> Array:
        facts = json.loads(view.stored_member("stereo", f"{view.key}.{ident}.json"))
        return np.array(facts["Q"], np.float64)

    glass = used.glass if isinstance(used, Rig) else None
    unknown = rig if isinstance(rig, str) else "the rig has no such unit"
    return [Pair(u, stored_Q(u.ident), units.get(u.ident), unknown, glass, then(u.ident), faces,
                 points) for u in scan.units]  # fmt: skip


def _check_calibration(record: Record, pair: Pair) -> None:
    """Check the cameras against those that the rig's file and the scanner's seed say."""
    if pair.unit is None:
        record.skip("stereo cameras", pair.unknown)
        return
    off = 0.0
    for stored, known in ((pair.stored.pair.left, pair.unit.nominal.left),
                          (pair.stored.pair.right, pair.unit.nominal.right)):  # fmt: skip
        off = max(off, float(np.abs(stored.K - known.K).max()), _pose_off(stored, known))
        off = max(off, float(np.abs(np.subtract(stored.distortion, known.distortion)).max()))
    record.measure("stereo cameras", off, CALIBRATION, "K, T or distortion is not the rig's")


def _pose_off(stored: Camera, known: Camera) -> float:
    return float(np.abs(stored.T - known.T).max())


def _check_Q(record: Record, pair: Pair) -> None:
    """Project true points into both views and have Q take them back."""
    rectified, view = pair.stored.pair, pair.stored.pair.camera
    R = view.T[:3, :3]
    left, right = ((pair.vertices - eye.position) @ R for eye in (rectified.left, rectified.right))
    x, y = (
        view.fx * left[:, 0] / left[:, 2] + view.cx,
        view.fy * left[:, 1] / left[:, 2] + view.cy,
    )
    disparity = x - (view.fx * right[:, 0] / right[:, 2] + rectified.cx_right)
    apart = view.fy * (left[:, 1] / left[:, 2] - right[:, 1] / right[:, 2])
    record.measure("stereo rows", np.abs(apart).max(), 1e-6,
                   "px between the rows of a point in both rectified views")  # fmt: skip
    h = np.stack([x, y, disparity, np.ones_like(x)], axis=1) @ pair.Q.T
    again = h[:, :3] / h[:, 3:] @ R.T + view.position
    off = np.linalg.norm(again - pair.vertices, axis=1).max()
    record.measure("Q", off, Q_M, "m between points and what Q makes of their projections")


def _check_scan(record: Record, pair: Pair) -> None:
    """Measured disparities through the stored Q must lie on the stored scan."""
    unit = pair.stored
    r, c = np.nonzero(np.isfinite(unit.disparity))
    if len(r) < FEWEST:
        record.skip("scan from pairs", "the unit matched too little")
        return
    x = np.stack([c * unit.step, r * unit.step, unit.disparity[r, c], np.ones(len(r))], axis=1)
    h = x[:: max(1, len(r) // 5000)] @ pair.Q.T
    points = h[:, :3] / h[:, 3:] @ unit.pair.camera.T[:3, :3].T + unit.pair.camera.position
    away = pair.scan.query(points)[0]
    apart: Any = pair.scan.query(pair.scan.data[::7], k=2)[0]
    record.measure("scan from pairs", np.median(away), SCAN_M + float(np.median(apart[:, 1])),
                   "m from disparities through Q to the scan (median)")  # fmt: skip
