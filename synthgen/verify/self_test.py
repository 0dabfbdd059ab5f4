"""The checks on trial: every known wrong-label defect put into samples of every kind of corpus.

A cell of the table fault x product says which check caught it, by which witness, or that the
product cannot show it and why. Three products: RGB (picture and labels, no depth), RGB-D, and
scan (points in place of pictures; from a z-buffer where the corpus simulates no scanner).
"""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus import Corpus, open_corpus
from synthgen.corpus.sample import Sample, Subject, View
from synthgen.models import pose_surface
from synthgen.registration.simulated import ScanSettings, simulate_scan
from synthgen.sampling.streams import stream
from synthgen.scene.relief import relief_of
from synthgen.scene.surface import DrawnSurface
from synthgen.verify.checks import check_view
from synthgen.verify.faults import FAULTS, NEXT_LABEL, Fault
from synthgen.verify.report import VerifyReport
from synthgen.verify.roundtrip import HandTrip, sample_trips

PRODUCTS = ("RGB", "RGB-D", "scan")
DEPTH_CHECKS = ("depth", "face", "normals")
# Who says so, if generator and checker share a mistake.
WITNESSES = {
    "camera": "the plan",
    "camera rotation": "orthonormality",
    "keypoints_2d": "float64 reference model and a plain matrix product",
    "keypoints_3d": "float64 reference model",
    "bone length": "anatomy",
    "chirality": "anatomy: the side to which fingers bend",
    "side": "the plan",
    "joint limits": "anatomical ranges",
    "keypoint frame": "projection and frame size",
    "visible too deep": "z-buffer",
    "mask": "z-buffer, not Mitsuba",
    "part": "instances",
    "depth": "z-buffer, not Mitsuba",
    "face": "z-buffer, not Mitsuba",
    "uv": "the model's atlas",
    "parts": "the model's part table",
    "normal length": "geometry",
    "normals": "differences of the depth map",
    "skin hue": "colour of skin under the recorded light",
    "stale image": "edges of the picture",
    "mirrored image": "edges of the picture",
    "round trip": "registration from the stored points alone",
    "readable": "the decoder",
}
_NO_DEPTH = "an RGB corpus stores no depth or normals"
_NO_PICTURE = "a scan corpus stores no pictures or camera labels"
_PICTURE = ("image", "camera", "keypoints", "labels", "depth")


@dataclass(frozen=True)
class Cell:
    """One fault in one product.

    Attributes
    ----------
    caught, of : int
        Samples in which the fault is caught.
    check, witness : str
        The first check that caught it, and what that check rests on.
    reason : str
        Why it cannot be observed; "" where it can.
    """

    fault: str
    product: str
    caught: int
    of: int
    check: str
    witness: str
    reason: str = ""

    @property
    def ok(self) -> bool:
        """Whether the fault is caught everywhere, or honestly not observable."""
        return bool(self.reason) or self.caught == self.of


@dataclass(frozen=True)
class SelfTest:
    """All cells, and what was raised on clean samples."""

    cells: tuple[Cell, ...]
    clean_samples: int
    false_alarms: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether every observable cell is caught and clean samples raise nothing."""
        return not self.false_alarms and all(cell.ok for cell in self.cells)

    def to_json(self) -> dict[str, Any]:
        """Return the table as JSON types."""
        cells = [{**asdict(cell), "ok": cell.ok} for cell in self.cells]
        return {"ok": self.ok, "clean_samples": self.clean_samples,
                "false_alarms": list(self.false_alarms), "cells": cells}  # fmt: skip


def self_test(path: str | Path, samples: int = 2, clean: int | None = None) -> SelfTest:
    """Put every fault into ``samples`` samples of a corpus; check ``clean`` untouched ones too.

    Parameters
    ----------
    path : str or Path
        A finished corpus with single hands.
    samples : int
        For each fault, spread over the corpus.
    clean : int or None
        Untouched samples to look for false alarms in; None: 4 x samples.
    """
    corpus = open_corpus(path)
    n = len(corpus)
    chosen = sorted({k * n // samples for k in range(min(samples, n))})
    cells = [_cell(corpus, chosen, name, fault, product)
             for name, fault in FAULTS.items() for product in PRODUCTS]  # fmt: skip
    wanted = min(n, 4 * samples if clean is None else clean)
    alarms = [f"sample {k}, {product}: {check}"
              for k in range(wanted) for product in PRODUCTS
              if (check := _caught(corpus, k, None, product))]  # fmt: skip
    return SelfTest(tuple(cells), wanted, tuple(alarms))


def _cell(corpus: Corpus, chosen: list[int], name: str, fault: Fault, product: str) -> Cell:
    reason = not_observable(fault, product)
    if reason:
        return Cell(name, product, 0, 0, "", "", reason)
    checks = [_caught(corpus, k, fault, product) for k in chosen]
    found = [check for check in checks if check]
    first = found[0] if found else ""
    return Cell(name, product, len(found), len(checks), first, WITNESSES.get(first, ""))


def not_observable(fault: Fault, product: str) -> str:
    """Return why a product cannot show a fault, or ""."""
    if product == "RGB" and fault.touches == "depth":
        return _NO_DEPTH
    if product == "scan" and fault.touches in _PICTURE:
        return _NO_PICTURE
    if product != "scan" and fault.touches == "scan":
        return "there is no scan"
    return ""


def _caught(corpus: Corpus, position: int, fault: Fault | None, product: str) -> str:
    """Name of the first check that catches a fault (None: a clean sample), or ""."""
    clean = corpus[position]
    if fault is not None and fault.touches == NEXT_LABEL:
        sample = _with_label_of(clean, corpus[(position + 1) % len(corpus)])
    else:
        sample = _broken(clean, fault)
    if product == "scan":
        return _round_trip(_scanned(sample, clean, fault))
    report = VerifyReport()
    try:
        with np.errstate(all="ignore"):
            for view in sample.views:
                check_view(report, sample, view)
    except (ValueError, KeyError, IndexError, FloatingPointError) as error:
        return "readable" if error else ""
    failed = [f.check for f in report.failures]
    if product == "RGB":
        failed = [check for check in failed if check not in DEPTH_CHECKS]
    if failed or product == "RGB":
        return failed[0] if failed else ""
    return _round_trip(sample)


def _broken(clean: Sample, fault: Fault | None) -> Sample:
    views = tuple(View(copy.deepcopy(v.meta), v.stored_member) for v in clean.views)
    if fault is not None:
        for view in views:
            fault.change(view)
    spec = type(clean.spec).from_json(views[0].meta["spec"])
    return Sample(clean.index, views, spec)


def _with_label_of(clean: Sample, other: Sample) -> Sample:
    """Pictures of one sample, everything else of the next."""
    views = []
    for own, foreign in zip(clean.views, other.views, strict=False):
        view = View(copy.deepcopy(foreign.meta), foreign.stored_member)
        for name in ("image", "depth_z_m"):
            view.__dict__[name] = getattr(own, name)
        views.append(view)
    return Sample(other.index, tuple(views), other.spec)


@dataclass(frozen=True, eq=False)
class _StandIn:
    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]


def _scanned(sample: Sample, clean: Sample, fault: Fault | None) -> Sample:
    """Give the broken sample a scan of the *clean* hand, which the fault may touch as well."""
    scan: Any = clean.scan
    if scan is None:
        truth = clean.subjects[0]
        rng = stream(0, "sample", clean.index, 0, "self test scan")
        settings = ScanSettings(points=12_000, outliers=0.0, pixels=150)
        vertices, faces = _drawn(truth)
        points, normals, _ = simulate_scan(vertices, faces, settings, rng=rng)
        scan = _StandIn(points, normals)
    if fault is not None and fault.points is not None:
        scan = _StandIn(*fault.points(np.asarray(scan.vertices), np.asarray(scan.normals)))
    scanned = replace(sample)
    scanned.__dict__["scan"] = scan  # in place of the one that would be read
    return scanned


def _drawn(truth: Subject) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the hand as it is drawn, without its arm."""
    drawn = DrawnSurface.for_model(truth.loaded)
    s = truth.description
    surface, _ = pose_surface(
        truth.loaded,
        truth.shape,
        truth.pose,
        truth.translation,
        np.array(s.wrist),
        np.array(s.elbow),
    )
    children = len(drawn.refined_faces) // len(truth.loaded.surface.faces)
    faces = drawn.refined_faces[: children * len(truth.loaded.faces)]
    used, own = np.unique(faces, return_inverse=True)
    relief = relief_of(truth.loaded, s.skin, truth.pose)
    return drawn.refine(surface, relief)[used], own.reshape(-1, 3)


def _round_trip(sample: Sample) -> str:
    trips: list[HandTrip] = sample_trips(sample, "gt")
    bad = [t for t in trips if t.verdict in ("truth_mismatch", "fail")]
    return "round trip" if bad else ""
