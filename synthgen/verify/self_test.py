"""The checks on trial: every known wrong-label defect put into samples of every kind of corpus.

A cell of the table fault x product says which checks catch it, by which witness, or that the
product cannot show it and why. Three products: RGB (pictures and labels, no depth), RGB-D, and
scan (points in place of pictures; from a z-buffer where the corpus simulates no scanner). Faults go
into stored copies of samples, which are judged as any corpus is: by ``verify --start gt``.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from synthgen.corpus import Corpus, open_corpus
from synthgen.verify.draft import Draft, write_drafts
from synthgen.verify.faults import FAULTS, Fault
from synthgen.verify.labels import verify
from synthgen.verify.roundtrip import round_trip
from synthgen.verify.stand_in import scanned
from synthgen.verify.stereo_faults import STEREO_FAULTS

PRODUCTS: dict[str, tuple[str, ...]] = {
    "RGB": ("image", "labels", "meta"),
    "RGB-D": ("image", "depth", "labels", "meta"),
    "scan": ("meta", "scan"),
}
# Stored with a product where the corpus has it: rectified pairs come with scanners only.
BESIDE = {"scan": "stereo"}
ALL_FAULTS = {**FAULTS, **STEREO_FAULTS}
ROUND_TRIP = "round trip"
# Who says so, if generator and checker share a mistake. Of code that both use (models, cameras) the
# tests have further ones: kornia for depth, normals and projection, smplx, mirror symmetry.
WITNESSES = {
    "camera": "the plan",
    "camera rotation": "orthonormality",
    "keypoints_2d": "float64 reference model and OpenCV's projection",
    "keypoints_3d": "float64 reference model",
    "bone length": "anatomy",
    "chirality": "anatomy: the side to which fingers bend",
    "side": "the plan",
    "joint limits": "anatomical ranges",
    "keypoint frame": "projection and frame size",
    "visible": "rays at triangles, not Mitsuba",
    "mask": "z-buffer, not Mitsuba",
    "part": "instances",
    "object part": "the plan",
    "meta": "the names and units that readers rely on, the plan",
    "objects": "the plan",
    "box": "counting",
    "pixels": "counting",
    "exr K": "the view's own calibration",
    "exr ids": "the label images",
    "exr depth": "the depth column",
    "exr picture": "brightness of the picture",
    "exr channels": "hue of the picture",
    "depth": "z-buffer, not Mitsuba",
    "face": "z-buffer, not Mitsuba",
    "uv": "the model's atlas",
    "barycentrics": "z-buffer, not Mitsuba",
    "parts": "the model's part table",
    "normal length": "geometry",
    "normals": "differences of the depth map",
    "skin hue": "colour of skin under the recorded light",
    "stale image": "edges and shading of the picture",
    "mirrored image": "edges of the picture",
    "scan error": "closest points on the surface as drawn",
    "scan error side": "closest points on the surface as drawn",
    "scan faces": "closest points on the surface as drawn",
    "scan barycentrics": "closest points on the surface as drawn",
    "scan normals": "closest points on the surface as drawn",
    "scan texture": "colours of the vertices",
    "scan colours": "colour of skin",
    "stereo units": "the scan's own report",
    "stereo cameras": "the rig's file and the scanner's seed",
    "stereo rows": "plain matrix products",
    "Q": "plain matrix products",
    "true disparity": "true surface through the true cameras, with OpenCV's lens model",
    "disparity grid": "slopes of the true surface",
    "disparity": "the true disparity",
    "disparity offset": "the true disparity",
    "stereo pictures": "correlation of the pictures",
    "stereo picture shift": "correlation of the pictures",
    "stereo picture place": "offsets of the pictures against slopes of the disparities",
    "disparity place": "slopes of the true disparity",
    "scan from pairs": "the scan",
    ROUND_TRIP: "registration from the stored points alone",
    "readable": "the decoder",
}
LACKING = {
    "image": "a scan has no pictures",
    "labels": "a scan has no label images",
    "depth": "no depth is stored",
    "scan": "no scan is stored",
    "stereo": "no rectified pairs are stored",
}
LOOKED_AT = 40  # samples in which a fault that needs something rare is looked for


@dataclass(frozen=True)
class Cell:
    """One fault in one product.

    Attributes
    ----------
    caught, of : int
        Samples in which the fault is caught.
    checks : dict
        Every check that caught it, and in how many samples.
    missed : tuple of int
        Numbers of the samples in which nothing caught it.
    reason : str
        Why it cannot be observed; "" where it can.
    unjudged : dict
        Samples, beside ``of``, in which the only check that shows it could not judge, by why.
    """

    fault: str
    product: str
    caught: int = 0
    of: int = 0
    checks: dict[str, int] = field(default_factory=dict)
    missed: tuple[int, ...] = ()
    reason: str = ""
    unjudged: dict[str, int] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether the fault is caught everywhere, or honestly not observable."""
        return bool(self.reason) or self.caught == self.of

    @property
    def check(self) -> str:
        """The check that catches it in most samples."""
        return max(self.checks, key=lambda name: self.checks[name]) if self.checks else ""


@dataclass(frozen=True)
class Judgement:
    """What the judges say of spoilt or clean samples, by the sample's number.

    ``raised``: the checks that failed; ``unjudged``: the checks that could not judge, and why.
    """

    raised: dict[int, set[str]] = field(default_factory=dict)
    unjudged: dict[int, dict[str, str]] = field(default_factory=dict)


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
        cells = [{**asdict(c), "ok": c.ok, "check": c.check, "witness": WITNESSES.get(c.check, "")}
                 for c in self.cells]  # fmt: skip
        return {"ok": self.ok, "clean_samples": self.clean_samples,
                "false_alarms": list(self.false_alarms), "cells": cells}  # fmt: skip


def self_test(
    path: str | Path, samples: int = 2, clean: int | None = None, *, progress: bool = False
) -> SelfTest:
    """Put every fault into ``samples`` samples of a corpus; check ``clean`` untouched ones too.

    Parameters
    ----------
    path : str or Path
        A finished corpus with single hands.
    samples : int
        For each fault, spread over the corpus.
    clean : int or None
        Untouched samples to look for false alarms in; None: 4 x samples.
    progress : bool
        Show a bar on a terminal.
    """
    corpus = open_corpus(path)
    wanted = min(len(corpus), 4 * samples if clean is None else clean)
    console = Console(stderr=True)
    with Progress(console=console, disable=not (progress and console.is_terminal)) as bar:
        cells = [cell(corpus, name, fault, product, samples)
                 for name, fault in bar.track(ALL_FAULTS.items(), description="known defects")
                 for product in PRODUCTS]  # fmt: skip
        alarms = [alarm for product in bar.track(tuple(PRODUCTS), description="clean samples")
                  for alarm in false_alarms(corpus, product, wanted)]  # fmt: skip
    return SelfTest(tuple(cells), wanted, tuple(alarms))


def cell(corpus: Corpus, name: str, fault: Fault, product: str, samples: int) -> Cell:
    """Put one fault into so many samples of one product, where it changes anything."""
    if fault.needs not in (*PRODUCTS[product], BESIDE.get(product)):
        return Cell(name, product, reason=LACKING[fault.needs])
    if missing := _missing(corpus, product, fault.needs):
        return Cell(name, product, reason=f"the corpus stores no {missing}")
    spoilt = list(islice(_spoilt(corpus, fault, product, samples), samples))
    if not spoilt:
        return Cell(name, product, reason=fault.absent)
    columns = (*PRODUCTS[product], *({fault.needs} - set(PRODUCTS[product])))
    said = judged(corpus, spoilt, product, columns)
    numbers = [draft.sample.index for draft in spoilt]
    silent = [number for number in numbers if not said.raised.get(number)]
    why = {number: reason for number in silent
           if (reason := said.unjudged.get(number, {}).get(fault.witness))}  # fmt: skip
    missed = tuple(number for number in silent if number not in why)
    counted = Counter(check for number in numbers for check in said.raised.get(number, ()))
    of = len(numbers) - len(why)
    reason = "" if of else f"{fault.witness} not judged: {next(iter(why.values()))}"
    return Cell(name, product, of - len(missed), of, dict(counted.most_common()), missed, reason,
                dict(Counter(why.values())))  # fmt: skip


def _spoilt(corpus: Corpus, fault: Fault, product: str, samples: int) -> Iterator[Draft]:
    """Drafts in which the fault changes something: those spread over the corpus first."""
    n = len(corpus)
    first = [k * n // samples for k in range(min(samples, n))]
    for position in dict.fromkeys([*first, *range(min(n, LOOKED_AT))]):
        draft, following = Draft(corpus, position), Draft(corpus, (position + 1) % n)
        if fault.needs == "scan":
            _complete(draft, product)
        fault.change(draft, following)
        if draft.changed:
            _complete(draft, product)
            yield draft


def _missing(corpus: Corpus, product: str, column: str = "meta") -> str:
    """Name the columns that a product, or a fault, needs and the corpus lacks.

    A scan may come from a z-buffer.
    """
    there = corpus[0].views[0].columns | {"scan"}
    return ", ".join(sorted({*PRODUCTS[product], column} - there))


def _complete(draft: Draft, product: str) -> None:
    """Give a draft that lacks the scan of its product one from a z-buffer."""
    if product == "scan" and draft.scan is None:
        draft.stand_in(scanned(draft.sample))


def false_alarms(corpus: Corpus, product: str, samples: int) -> list[str]:
    """Return what the judges raise on untouched samples, spread over the corpus."""
    if _missing(corpus, product):
        return []
    n = len(corpus)
    chosen = sorted({k * n // samples for k in range(samples)})
    beside = {BESIDE.get(product, "meta")} & corpus[0].views[0].columns
    columns = (*PRODUCTS[product], *(beside - set(PRODUCTS[product])))
    raised: dict[int, set[str]] = {}
    for k in range(0, len(chosen), LOOKED_AT):
        drafts = [Draft(corpus, position) for position in chosen[k : k + LOOKED_AT]]
        for draft in drafts:
            _complete(draft, product)
        raised |= judged(corpus, drafts, product, columns).raised
    return [f"sample {index}, {product}: {', '.join(sorted(checks))}"
            for index, checks in sorted(raised.items())]  # fmt: skip


def judged(
    corpus: Corpus, drafts: Sequence[Draft], product: str, columns: Sequence[str]
) -> Judgement:
    """Store drafts as a corpus with these columns and verify it."""
    said = Judgement()
    with tempfile.TemporaryDirectory(prefix="synthgen-") as folder:
        out = Path(folder) / product
        write_drafts(corpus, drafts, columns, out)
        with np.errstate(all="ignore"):
            report = verify(out)
            for failure in report.failures:
                said.raised.setdefault(failure.sample, set()).add(failure.check)
            for row in report.unjudged:
                said.unjudged.setdefault(row.sample, {})[row.check] = row.reason
            if product != "RGB":
                for trip in round_trip(out, "gt").trips:
                    if trip.verdict == "truth_mismatch":
                        said.raised.setdefault(trip.sample, set()).add(ROUND_TRIP)
    return said
