"""``synthgen fit --sequence``: scans that are the frames of one moving subject."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synthgen.cli.fit import _names, _write, spared
from synthgen.cli.output import DONE, FAILED, Result
from synthgen.errors import ShapeError, WorkLeft

if TYPE_CHECKING:
    from synthgen.registration.fitted import Fit
    from synthgen.registration.inspection import Expected
    from synthgen.registration.reading import StoredScan
    from synthgen.registration.tracking import Track


def fit_sequence(
    scans: list[Path],
    out: Path,
    model: str,
    hand: str,
    start: Any,
    *,
    coupled: bool,
    units: str,
    progress: bool,
) -> Result:
    """Track a subject; results of each frame, ``sequence.json`` and ``sequence.npz`` go to out."""
    from rich.console import Console
    from rich.progress import Progress

    from synthgen.models import load
    from synthgen.registration.inspection import expected_of
    from synthgen.registration.tracking import track

    loaded = load(model)
    reel = _Reel(scans, units, expected_of(loaded))
    spared(scans, out, reel.names)
    out.mkdir(parents=True, exist_ok=True)
    reports: list[dict[str, Any]] = []
    lines: list[str] = []
    with Progress(console=Console(stderr=True), transient=True, disable=not progress) as bar:
        task = bar.add_task("frames", total=len(scans))

        def done(k: int, found: Fit) -> None:
            scan = reel.read.pop(k)
            reports.append(_write(out, reel.names[k], scans[k], scan, found))
            lines.append(_line(scans[k], scan, found))
            bar.advance(task)

        try:
            found = track(reel.frames(), loaded, start, hand, coupled=coupled, done=done)
        except KeyboardInterrupt as error:
            place = _partial(out, reports)
            raise WorkLeft(
                f"interrupted after {len(reports)} of {len(scans)} frames, which are in {place}; "
                "the same command begins again at the first"
            ) from error
    payload = {"out": str(out), "fits": reports, "sequence": _written(out, found, reports)}
    counts = ", ".join(f"{n} {verdict}" for verdict, n in found.report["verdicts"].items())
    seconds = found.report["cpu_s"]
    lines += [
        f"{len(reports)} frames: {counts}; {seconds['total']:.1f} CPU s, "
        f"{seconds['shape']:.1f} of them for the shape",
        f"results in {out}, the whole in {out / 'sequence.json'}",
    ]
    failed = found.report["verdicts"]["fail"] > 0
    return Result(payload, lines, FAILED if failed else DONE)


@dataclass
class _Reel:
    """Frames read one at a time; ``read`` are those that are not done yet."""

    paths: list[Path]
    units: str
    expected: Expected
    read: dict[int, StoredScan] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.names = _names(self.paths)
        for path in self.paths:
            if not path.is_file():
                raise ShapeError(f"{path}: no such file; name the frames in their order")

    def frames(self) -> Iterator[tuple[Any, Any]]:
        """Yield points and normals; all frames have the unit of the first that shows its own."""
        for k, path in enumerate(self.paths):
            self.read[k] = scan = self._scan(k, path)
            if self.units == "auto" and scan.units:
                self.units = scan.units
            yield scan.points, scan.normals

    def _scan(self, k: int, path: Path) -> StoredScan:
        """Read a frame; a later one that cannot be read is an empty one."""
        import numpy as np

        from synthgen.registration.reading import StoredScan, read_scan

        try:
            return read_scan(path, self.units, self.expected)
        except ShapeError as error:
            if k == 0:
                raise
            return StoredScan(np.zeros((0, 3)), None, "", str(error))


def _line(path: Path, scan: StoredScan, found: Fit) -> str:
    """One frame in words."""
    report = found.report
    reason = f" ({found.reason})" if found.reason else ""
    if (message := report.get("message")) is not None:
        why = message if scan.units or not scan.note else scan.note
        return f"{path}: {found.verdict}{reason}: {why}; the last fit, if any, is repeated"
    s = report["statistics"]
    numbers = "" if s is None or "noise_mm" not in s else (
        f"; noise {s['noise_mm']:.2f} mm, {100 * s['explained']:.1f} % explained"
    )  # fmt: skip
    held = "" if report.get("followed", True) else "; the last fit, if any, is repeated"
    held = "; begun afresh" if report.get("start") == "afresh" and not held else held
    seconds = report["cpu_s"]["total"]
    return f"{path}: {found.verdict}{reason}{numbers}{held}; {seconds:.1f} CPU s"


FRAME_KEYS = ("scan", "verdict", "reason", "followed", "unseen_frames", "files")


def _partial(out: Path, reports: list[dict[str, Any]]) -> Path:
    """Write what is known of a sequence that was interrupted."""
    frames = [{key: report.get(key) for key in FRAME_KEYS} for report in reports]
    place = out / "sequence.json"
    place.write_text(json.dumps({"complete": False, "frames": frames}, indent=2) + "\n",
                     encoding="utf-8")  # fmt: skip
    return place


def _written(out: Path, found: Track, reports: list[dict[str, Any]]) -> dict[str, Any]:
    """Write the sequence as JSON and npz; return the JSON."""
    import numpy as np

    fits = found.fits
    np.savez(
        out / "sequence.npz", shape=found.shape, pose=np.array([f.pose for f in fits]),
        translation=np.array([f.translation for f in fits]),
        followed=np.array(found.report["followed"]),
        verdict=np.array([f.verdict for f in fits]), reason=np.array([f.reason for f in fits]),
    )  # fmt: skip
    frames = [{key: report.get(key) for key in FRAME_KEYS} for report in reports]
    payload = {
        "complete": True,
        "model": found.model.name, "model_digest": found.model.digest,
        "shape": found.shape.tolist(), "parameters": "sequence.npz", "frames": frames,
        "verdicts": found.report["verdicts"], "cpu_s": found.report["cpu_s"],
    }  # fmt: skip
    text = json.dumps(payload, indent=2)
    (out / "sequence.json").write_text(text + "\n", encoding="utf-8")
    return payload
