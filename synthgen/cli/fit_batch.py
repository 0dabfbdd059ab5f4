"""``synthgen fit`` of single scans: of a list, the same command leaves out what is done already."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from synthgen import __version__
from synthgen.cli.fit_files import names_of, report_of, spared, write
from synthgen.cli.output import DONE, FAILED, WRONG, Result
from synthgen.errors import ShapeError, WorkLeft

if TYPE_CHECKING:
    from synthgen.models import BodyModel

VERDICTS = ("pass", "unobserved", "fail")


@dataclass(frozen=True)
class Options:
    """What decides a fit beside scan and model."""

    hand: str
    start: Any
    coupled: bool
    preset: str
    units: str
    smooth: bool = False

    @property
    def curved(self) -> float:
        """Return how far the scanned surface bulges above the model's triangles."""
        from synthgen.registration.correspondences import SMOOTH

        return SMOOTH if self.smooth else 0.0

    def told(self) -> list[Any]:
        """Return them as JSON types."""
        import numpy as np

        word = isinstance(self.start, str)
        begin = self.start if word else [np.asarray(part).tolist() for part in self.start]
        return [self.hand, begin, self.coupled, self.preset, self.units, self.smooth]


@dataclass
class Batch:
    """Scans to fit, and what became of them: reports of fits, errors of what is no scan."""

    scans: list[Path]
    out: Path
    model: BodyModel
    options: Options
    reports: list[dict[str, Any]] = field(default_factory=list)
    unreadable: list[dict[str, str]] = field(default_factory=list)
    recalled: int = 0

    def __post_init__(self) -> None:
        self.names = names_of(self.scans)
        self.digest = self.model.digest + _learned(self.model)

    def one(self, number: int, *, again: bool) -> str:
        """Fit one scan, or recall its fit; return it in words."""
        from synthgen.registration import fit as register
        from synthgen.registration.inspection import expected_of
        from synthgen.registration.reading import read_scan

        path, name = self.scans[number], self.names[number]
        key = key_of(path, self.digest, self.options)
        report = None if again else report_of(self.out, name, key)
        if report is not None:
            self.recalled += 1
            self.reports.append(report)
            return f"{_line(report)}; it was there already"
        try:
            scan = read_scan(path, self.options.units, expected_of(self.model))
        except ShapeError as error:
            if len(self.scans) == 1:
                raise
            self.unreadable.append({"scan": str(path), "error": str(error)})
            return f"{error}: left out"
        o = self.options
        found = register(scan.points, scan.normals, self.model, o.start, o.hand,
                         preset=o.preset, coupled=o.coupled, curved=o.curved)  # fmt: skip
        self.reports.append(write(self.out, name, path, scan, found, key))
        return _line(self.reports[-1])

    def result(self, lines: list[str]) -> Result:
        """Sum up."""
        counts = Counter(report["verdict"] for report in self.reports)
        if len(self.scans) > 1:
            lines.append(self._summary(counts))
        lines.append(
            f"results in {self.out}: .npz parameters, .ply mesh, .png picture, .json report"
        )
        payload = {
            "out": str(self.out), "fits": self.reports, "unreadable": self.unreadable,
            "verdicts": {v: counts[v] for v in VERDICTS}, "there_already": self.recalled,
        }  # fmt: skip
        bad = FAILED if counts["fail"] else DONE
        return Result(payload, lines, WRONG if self.unreadable else bad)

    def _summary(self, counts: Counter[str]) -> str:
        told = [f"{counts[v]} {v}" for v in VERDICTS]
        told += [f"{n} unreadable" for n in [len(self.unreadable)] if n]
        seconds = sum(report.get("cpu_s", {}).get("total", 0.0) for report in self.reports)
        told[-1] += f"; {seconds:.1f} CPU s"
        told += [f"{n} were there already (--again fits them anew)" for n in [self.recalled] if n]
        return f"{len(self.scans)} scans: {', '.join(told)}"


def fit_batch(
    scans: list[Path],
    out: Path,
    model: str,
    options: Options,
    *,
    again: bool,
    progress: bool,
) -> Result:
    """Fit scans one after the other; what the same command has done before is not done again."""
    from rich.console import Console
    from rich.progress import Progress

    from synthgen.corpus.atomic import make_folder
    from synthgen.models import load
    from synthgen.registration.fit import check_options
    from synthgen.registration.reading import check_file

    batch = Batch(scans, out, load(model), options)
    check_options(batch.model, options.start, options.hand, options.preset, options.curved)
    for path in scans:
        check_file(path, options.units)
    spared(scans, out, batch.names)
    make_folder(out)
    lines: list[str] = []
    shown = progress and len(scans) > 1
    with Progress(console=Console(stderr=True), transient=True, disable=not shown) as bar:
        try:
            for number in bar.track(range(len(scans)), description="scans"):
                lines.append(batch.one(number, again=again))
        except KeyboardInterrupt as error:
            raise WorkLeft(
                f"interrupted after {len(lines)} of {len(scans)} scans, whose results are in "
                f"{out}; the same command goes on from there"
            ) from error
    return batch.result(lines)


def key_of(path: Path, digest: str, options: Options) -> str:
    """Return a name of all that decides a fit: scan, model, options and version.

    ``digest`` is that of the model and of what was learned for it.
    """
    content = [_digest(file) for file in (path, *_buffers(path))]
    told = json.dumps([__version__, str(path), content, digest, *options.told()])
    return hashlib.sha256(told.encode()).hexdigest()


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _buffers(path: Path) -> list[Path]:
    """Return the files beside a glTF that hold its points."""
    if path.suffix.lower() != ".gltf":
        return []
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        named = [row["uri"] for row in told["buffers"] if "uri" in row]
        beside = [path.parent / unquote(uri) for uri in named if not uri.startswith("data:")]
        return [file for file in beside if file.is_file()]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return []  # no glTF, as reading it will say


def _learned(model: BodyModel) -> str:
    """Return the digest of the user's own initialiser of a model, which train-init may renew."""
    from synthgen.models import mirror_model
    from synthgen.registration.initialiser import initialiser_path

    path = initialiser_path(mirror_model(model) if model.hand == "left" else model)
    return _digest(path) if path.is_file() else ""


def _line(report: dict[str, Any]) -> str:
    """One fit in words."""
    path, note = report["scan"], report["units_note"]
    if (message := report.get("message")) is not None:
        return f"{path}: fail ({report['reason']}): {message}; {note}"
    s = report["statistics"]
    reason = f" ({report['reason']})" if report["reason"] else ""
    numbers = "" if s is None else (
        f"; noise {s['noise_mm']:.2f} mm, {100 * s['explained']:.1f} % explained, "
        f"vertices known to {s['predicted_vertex_sd_mm']['median']:.2f} mm"
    )  # fmt: skip
    seconds = report["cpu_s"]["total"]
    what = "body" if report["hand"] is None else f"{report['hand']} hand"
    return f"{path}: {report['verdict']}{reason}, {what}{numbers}; {note}; {seconds:.1f} CPU s"
