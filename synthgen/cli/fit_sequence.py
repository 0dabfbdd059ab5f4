"""``synthgen fit --sequence``: scans that are the frames of one moving subject."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from synthgen.cli.fit_files import spared, write
from synthgen.cli.output import DONE, FAILED, Result
from synthgen.cli.sequence_log import Log, Reel, key_of
from synthgen.errors import ConfigError, WorkLeft

if TYPE_CHECKING:
    from synthgen.registration.fitted import Fit
    from synthgen.registration.reading import StoredScan

TEMPLATES = {"auto": None, "yes": True, "no": False}


def fit_sequence(
    scans: list[Path],
    out: Path,
    model: str,
    hand: str,
    start: Any,
    *,
    coupled: bool,
    template: str,
    units: str,
    again: bool,
    progress: bool,
) -> Result:
    """Track a subject; results of each frame, ``sequence.json`` and ``sequence.npz`` go to out."""
    from rich.console import Console
    from rich.progress import Progress

    from synthgen.models import load
    from synthgen.registration.inspection import expected_of
    from synthgen.registration.tracking import track

    if template not in TEMPLATES:
        raise ConfigError(f"--template {template}; expected {', '.join(TEMPLATES)}")
    loaded = load(model)
    reel = Reel(scans, units, expected_of(loaded))
    spared(scans, out, reel.names)
    out.mkdir(parents=True, exist_ok=True)
    log = Log(out, reel, key_of(scans, loaded.digest, hand, start, coupled, template, units))
    place = None if again else log.recalled()
    lines = [f"{len(log.reports)} frames were there already"] if log.reports else []
    with Progress(console=Console(stderr=True), transient=True, disable=not progress) as bar:
        task = bar.add_task("frames", total=len(scans), completed=len(log.reports))

        def done(_: int, found: Fit) -> None:
            k = len(log.reports)
            scan = reel.read.pop(k)
            log.reports.append(write(out, reel.names[k], scans[k], scan, found))
            lines.append(_line(scans[k], scan, found))
            bar.advance(task)

        try:
            if len(log.reports) < len(scans):
                frames = reel.frames(len(log.reports))
                track(frames, loaded, start, hand, template=TEMPLATES[template], coupled=coupled,
                      done=done, paused=log.paused, resume=place)  # fmt: skip
        except KeyboardInterrupt as error:
            raise WorkLeft(
                f"interrupted after {len(log.reports)} of {len(scans)} frames, which are in "
                f"{log.partial()}; the same command goes on from there"
            ) from error
    whole = log.finished(loaded)
    counts = ", ".join(f"{n} {verdict}" for verdict, n in whole["verdicts"].items())
    lines += [
        f"{len(log.reports)} frames: {counts}; {whole['cpu_s']['total']:.1f} CPU s, "
        f"{whole['cpu_s']['shape']:.1f} of them for the shape",
        f"results in {out}, the whole in {out / 'sequence.json'}",
    ]
    payload = {"out": str(out), "fits": log.reports, "sequence": whole}
    return Result(payload, lines, FAILED if whole["verdicts"]["fail"] else DONE)


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
