"""The round trip: fit the model back to what is stored, and compare with the truth.

``truth_mismatch`` is the alarm: the fit passes and the truth is far, or the stored points do not
lie on the true surface. A fit that fails while the truth explains the points is the fitter's
failure, not the sample's: its reason also says what a fit from the truth would have been. So is
a fit that passes and is far where the truth explains the points as well (``false_pass``).
``unobserved`` is counted, not failed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from synthgen.corpus import open_corpus
from synthgen.corpus.sample import Sample, Subject
from synthgen.errors import ShapeError, SynthgenError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.registration import Fit, fit
from synthgen.registration.statistics import PARTS, part_of_vertex
from synthgen.sampling.streams import stream
from synthgen.verify.against_truth import (
    CURVED,
    contradiction,
    truth_explained,
    truth_fits_as_well,
)
from synthgen.verify.report import UNREADABLE
from synthgen.verify.stored_points import StoredPoints, stored_points

Array = NDArray[np.float64]
STARTS = ("gt", "perturbed", "cold")
PERTURBED_DEG, SEEN_M = 15.0, 2.5e-3
# Of the noise, per coordinate, at 10 000 points; what the drawn surface's curvature adds.
FLOOR_SHARE, FLOOR_M = 0.3, 1e-4
MISMATCH_FLOORS, MISMATCH_M = 5.0, 1e-3


@dataclass(frozen=True, eq=False)
class HandTrip:
    """One hand's round trip: how it ended and by how much; ``fit`` is None without points."""

    sample: int
    hand_number: int
    verdict: str
    reason: str
    source: str
    figures: dict[str, Any] = field(default_factory=dict)
    fit: Fit | None = None
    points: Array | None = None
    truth: Array | None = None

    def to_json(self) -> dict[str, Any]:
        """Return everything but the arrays."""
        report = {} if self.fit is None else {"fit": self.fit.report}
        return {"sample": self.sample, "hand": self.hand_number, "verdict": self.verdict,
                "reason": self.reason, "source": self.source, **self.figures,
                **report}  # fmt: skip

    @property
    def badness(self) -> tuple[int, float]:
        """Larger is worse: alarms, then fails, then unobserved, by error."""
        order = {"truth_mismatch": 3, "fail": 2, "unobserved": 1}
        return order.get(self.verdict, 0), float(self.figures.get("v2v_mean_mm", 0.0))


@dataclass(frozen=True, eq=False)
class RoundTrip:
    """All hands of a corpus."""

    start: str
    trips: Sequence[HandTrip]

    @property
    def counts(self) -> dict[str, int]:
        """How often each verdict was given."""
        return dict(sorted(Counter(trip.verdict for trip in self.trips).items()))

    @property
    def ok(self) -> bool:
        """Whether no alarm was raised."""
        return not any(trip.verdict == "truth_mismatch" for trip in self.trips)

    @property
    def worst_first(self) -> list[HandTrip]:
        """The trips, worst first."""
        return sorted(self.trips, key=lambda trip: trip.badness, reverse=True)

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON types, worst first."""
        fitted = [t for t in self.trips if "v2v_mean_mm" in t.figures and t.verdict == "pass"]
        return {
            "start": self.start,
            "ok": self.ok,
            "counts": self.counts,
            "passed": {
                name: float(np.mean([t.figures[name] for t in fitted]))
                for name in ("v2v_mean_mm", "v2v_seen_mean_mm", "surface_seen_mm", "floor_mm")
            } if fitted else {},
            "hands": [trip.to_json() for trip in self.worst_first],
        }  # fmt: skip


def round_trip(
    path: str | Path,
    start: str = "perturbed",
    samples: int | None = None,
    *,
    progress: bool = False,
) -> RoundTrip:
    """Fit every hand of a corpus (or of ``samples`` of it, spread out) from a start.

    Parameters
    ----------
    path : str or Path
    start : "gt", "perturbed" (rotation within 15 degrees, mean pose) or "cold"
    samples : int or None
    progress : bool
        Show a bar on a terminal.
    """
    if start not in STARTS:
        raise ShapeError(f"start={start!r}; expected {', '.join(STARTS)}")
    corpus = open_corpus(path)
    n = len(corpus)
    chosen = range(n) if samples is None or samples >= n else sorted(
        {k * n // samples for k in range(samples)}
    )  # fmt: skip
    console, trips = Console(stderr=True), []
    with Progress(console=console, disable=not (progress and console.is_terminal)) as bar:
        for position in bar.track(chosen, description="round trip"):
            try:
                trips += sample_trips(corpus[position], start)
            except UNREADABLE as error:
                number, message = corpus.index_of(position), f"{type(error).__name__}: {error}"
                trips.append(HandTrip(number, 0, "truth_mismatch", message, "unreadable"))
    return RoundTrip(start, trips)


def sample_trips(sample: Sample, start: str) -> list[HandTrip]:
    """Fit every hand of one sample."""
    return [_trip(sample, number, start) for number in range(len(sample.subjects))]


def _trip(sample: Sample, number: int, start: str) -> HandTrip:
    subject = sample.subjects[number]
    try:
        stored = stored_points(sample, number)
        if stored.source == "none":
            return HandTrip(sample.index, number, "labels only", "no depth is stored", "none")
        begin = starting_point(sample.index, subject, start)
        found = fit(stored.points, stored.normals, subject.loaded, begin, subject.hand,
                    viewpoints=stored.viewpoints, curved=CURVED)  # fmt: skip
        trip = judged(sample.index, number, subject, stored, found)
        if trip.verdict == "fail" and start != "gt":
            return replace(
                trip, reason=f"{trip.reason}; from the truth {_from_truth(sample, number)}"
            )
        return trip
    except (SynthgenError, ValueError, np.linalg.LinAlgError) as error:
        return HandTrip(sample.index, number, "truth_mismatch", f"{type(error).__name__}: {error}",
                        "unreadable")  # fmt: skip


def _from_truth(sample: Sample, number: int) -> str:
    """How the fit ends that starts from the truth: the sample is sound if it is no fail."""
    again = _trip(sample, number, "gt")
    return f"{again.verdict} {again.reason.partition(':')[0]}".strip()


def starting_point(index: int, subject: Subject, start: str) -> Any:
    """Return what :func:`synthgen.registration.fit` starts from."""
    if start == "cold":
        return "cold"
    if start == "gt":
        return subject.shape, subject.pose, subject.translation
    from scipy.spatial.transform import Rotation

    rng = stream(0, "sample", index, 0, "round trip start")
    axis = rng.standard_normal(3)
    turn = Rotation.from_rotvec(
        axis / np.linalg.norm(axis) * np.deg2rad(PERTURBED_DEG * rng.random())
    )
    pose = np.zeros_like(subject.pose)
    mean = subject.loaded.hands_mean
    if mean is not None:
        pose[1:] = mean.reshape(-1, 3)
    pose[0] = (turn * Rotation.from_rotvec(subject.pose[0])).as_rotvec()
    return np.zeros_like(subject.shape), pose, subject.translation


def judged(index: int, number: int, subject: Subject, stored: StoredPoints, found: Fit) -> HandTrip:
    """Compare a fit with the truth."""
    truth = subject.vertices.astype(np.float64)
    figures = compare(subject, stored, found)
    if found.reason == "no_points":  # nothing was fitted: nothing is off
        figures = {name: figures[name] for name in ("coverage", "coverage_all", "floor_mm")}
    explained, by_part = truth_explained(subject, stored)
    figures["truth_explains"], figures["truth_explains_parts"] = explained, by_part
    limit = max(MISMATCH_FLOORS * figures["floor_mm"], 1e3 * MISMATCH_M)
    verdict: str = found.verdict
    reason = found.reason
    # an unobserved hand is ambiguous: only the points themselves can contradict its truth
    if verdict == "pass" and figures["v2v_seen_mean_mm"] > limit:
        off = f"its seen vertices are {figures['v2v_seen_mean_mm']:.1f} mm off"
        if truth_fits_as_well(subject, stored, found):
            verdict, reason = (
                "fail",
                f"false_pass: {off}, and the truth explains the points as well",
            )
        else:
            verdict, reason = "truth_mismatch", f"the fit is good, {off}"
    against = contradiction(explained, by_part)
    if against and found.reason != "no_points":
        verdict, reason = "truth_mismatch", against
    return HandTrip(index, number, verdict, reason, stored.source, figures, found, stored.points,
                    truth)  # fmt: skip


def compare(subject: Subject, stored: StoredPoints, found: Fit) -> dict[str, Any]:
    """Errors of a fit against the truth; millimetres, degrees, standard deviations of shape."""
    import igl
    from scipy.spatial import cKDTree

    truth = subject.vertices.astype(np.float64)
    off = 1e3 * np.linalg.norm(found.vertices - truth, axis=1)
    seen = np.zeros(len(truth), dtype=bool)
    if len(stored.points):
        nearest: Any = cKDTree(stored.points).query(truth)[0]
        seen = nearest < SEEN_M
    faces = np.ascontiguousarray(found.model.faces, dtype=np.int64)
    true_faces = np.ascontiguousarray(subject.loaded.faces, dtype=np.int64)
    forth = 1e3 * np.sqrt(igl.point_mesh_squared_distance(truth, found.vertices, faces)[0])
    back = 1e3 * np.sqrt(igl.point_mesh_squared_distance(found.vertices, truth, true_faces)[0])
    noise = max(stored.noise_m, 1e-3 * _fit_noise_mm(found))
    floor = 1e3 * max(FLOOR_SHARE * noise, FLOOR_M, stored.bias_m)
    part = part_of_vertex(subject.loaded)
    angles = _angles_deg(found.pose, subject.pose)
    return {
        "v2v_mean_mm": float(off.mean()),
        "v2v_p95_mm": float(np.quantile(off, 0.95)),
        "v2v_max_mm": float(off.max()),
        "v2v_seen_mean_mm": float(off[seen].mean()) if seen.any() else float(off.mean()),
        "v2v_unseen_mean_mm": float(off[~seen].mean()) if (~seen).any() else 0.0,
        "surface_mm": {"truth_to_fit": float(forth.mean()), "fit_to_truth": float(back.mean())},
        "surface_seen_mm": float(forth[seen].mean()) if seen.any() else float(forth.mean()),
        "joints_mean_mm": float(1e3 * np.linalg.norm(found.joints - subject.joints, axis=1).mean()),
        "joint_angles_deg": {name: float(a) for name, a in
                             zip(subject.loaded.joint_names, angles, strict=True)},
        "rotation_deg": float(angles[0]),
        "shape_error_sd": float(np.abs(found.shape - subject.shape).mean()),
        "coverage": {name: float(seen[part == k].mean()) for k, name in enumerate(PARTS)},
        "coverage_all": float(seen.mean()),
        "floor_mm": floor,
        "floor_ratio": float(off[seen].mean() / floor) if seen.any() else None,
    }  # fmt: skip


def _fit_noise_mm(found: Fit) -> float:
    statistics = found.report.get("statistics")
    return 0.0 if statistics is None else float(statistics["noise_mm"])


def _angles_deg(pose: Array, truth: Array) -> Array:
    a, b = matrix_from_axis_angle(pose), matrix_from_axis_angle(truth)
    trace = np.einsum("kab,kab->k", a, b)
    return np.asarray(np.rad2deg(np.arccos(np.clip((trace - 1) / 2, -1, 1))))
