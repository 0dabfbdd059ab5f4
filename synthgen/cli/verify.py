"""``synthgen verify``: recompute labels, fit the model back, put the checks on trial."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from synthgen.cli.options import CorpusDir, Json
from synthgen.cli.output import DONE, FAILED, Result, columns, finite
from synthgen.errors import ConfigError, nearest

if TYPE_CHECKING:
    from synthgen.verify.report import Failure, VerifyReport
    from synthgen.verify.roundtrip import HandTrip, RoundTrip
    from synthgen.verify.self_test import Cell

SHOWN = 20

Some = Annotated[
    int | None,
    typer.Option(
        "--samples",
        metavar="N",
        min=1,
        help="Check N samples, spread out; all if not given. With --self-test: spoil N (2).",
    ),
]
Report = Annotated[
    Path | None,
    typer.Option(
        "--report",
        metavar="FILE.json",
        help="Write all findings as JSON; --start adds a page with pictures, FILE.html.",
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="gt|perturbed|cold",
        help="Also fit the model to what is stored and compare with the truth, starting there, "
        "turned by up to 15 degrees in the mean pose, or from nothing.",
    ),
]
SelfTest = Annotated[
    bool,
    typer.Option(
        "--self-test", help="Instead: put every known defect into copies and see it caught."
    ),
]


def verify(
    directory: CorpusDir,
    samples: Some = None,
    start: Start = None,
    report: Report = None,
    self_test: SelfTest = False,
    as_json: Json = False,
) -> Result:
    """Check a corpus against the truth it was made from; --start adds the round trip.

    Exit code 1: a label is wrong, stored points contradict the truth,
    or the self-test missed a defect. Fits that fail, and hands of which
    too little is seen, are counted only.
    """
    _checked(directory, start, report, self_test)
    if self_test:
        return _self_test(directory, samples, report, not as_json)
    from synthgen.verify.labels import verify as check

    found = check(directory, samples=samples, progress=not as_json)
    payload = found.to_json()
    lines = [_line(failure) for failure in found.failures[:SHOWN]]
    hidden = len(found.failures) - len(lines)
    lines += [f"... and {hidden} more (--report FILE holds all)"] if hidden > 0 else []
    verdict = "ok" if found.ok else f"{len(found.failures)} failures"
    if found.never_judged:
        verdict += f", but nothing is known of {', '.join(found.never_judged)}"
    lines.append(f"{directory}: {found.samples} samples, {found.views} views checked: {verdict}")
    if found.there < found.planned:
        lines.append(f"{found.there} of {found.planned} planned samples are made; `synthgen "
                     "generate` with the same arguments makes the rest")  # fmt: skip
    lines += [
        f"not judged: {check}, {times} of {times + found.judged[check]}: {reason}"
        for check, reasons in found.reasons().items()
        for reason, times in reasons.items()
    ]
    lines += [f"{n} views store no {column}: only their other labels were checked"
              for column, n in sorted(found.lacking.items())]  # fmt: skip
    good = found.ok
    if start is not None:
        trip = _round_trip(directory, samples, start, report, not as_json, found)
        payload["round_trip"] = trip.to_json()
        payload["ok"] = good = good and trip.ok
        lines += _trip_lines(trip)
    _save(report, payload)
    return Result(payload, lines, DONE if good else FAILED)


def _checked(directory: Path, start: str | None, report: Path | None, self_test: bool) -> None:
    """Refuse wrong options before anything long is done."""
    from synthgen.verify.roundtrip import STARTS

    if start is not None and self_test:
        raise ConfigError(f"--start {start} is no part of --self-test; give one of the two")
    if start is not None and start not in STARTS:
        raise ConfigError(
            f"--start {start!r}; expected {', '.join(STARTS)}{nearest(start, STARTS)}"
        )
    if report is None:
        return
    place = report.resolve()
    if report.suffix.lower() != ".json":
        raise ConfigError(f"--report {report}: expected a file that ends in .json")
    if place.is_dir() or not place.parent.is_dir():
        what = "is a folder" if place.is_dir() else f"there is no folder {place.parent}"
        raise ConfigError(f"--report {report}: {what}; name a file in a folder that exists")
    if place.is_relative_to(directory.resolve()):
        raise ConfigError(f"--report {report}: would lie inside the corpus; name a place beside it")


def _round_trip(
    directory: Path,
    samples: int | None,
    start: str,
    report: Path | None,
    progress: bool,
    labels: VerifyReport,
) -> RoundTrip:
    from synthgen.verify.roundtrip import round_trip
    from synthgen.verify.roundtrip_page import write_page

    trip = round_trip(directory, start, samples, progress=progress)
    if report is not None:
        write_page(report.with_suffix(".html"), trip, directory.resolve().name, labels)
    return trip


def _trip_lines(trip: RoundTrip) -> list[str]:
    told = [hand for hand in trip.worst_first if hand.verdict not in ("pass", "labels only")]
    lines = [_trip_line(hand) for hand in told[:SHOWN]]
    hidden = len(told) - len(lines)
    lines += [f"... and {hidden} more hands (--report FILE holds all)"] if hidden > 0 else []
    counts = ", ".join(f"{n} {verdict}" for verdict, n in trip.counts.items())
    if set(trip.counts) == {"labels only"}:
        return [f"round trip: none, {counts}: neither depth nor a scan is stored"]
    figures = trip.to_json()["passed"]
    error = "" if not figures else (
        f"; passed hands: vertices {figures['v2v_mean_mm']:.2f} mm, seen "
        f"{figures['v2v_seen_mean_mm']:.2f} mm"
    )  # fmt: skip
    state = "no alarm" if trip.ok else "TRUTH MISMATCH"
    return [*lines, f"round trip from {trip.start}: {counts}{error}: {state}"]


def _trip_line(hand: HandTrip) -> str:
    error = hand.figures.get("v2v_seen_mean_mm")
    far = "" if error is None else f", seen vertices {error:.2f} mm off"
    place = f"sample {hand.sample}" + (f", hand {hand.hand_number}" if hand.hand_number else "")
    return f"{place}: {hand.verdict} ({hand.reason}){far}"


def _self_test(directory: Path, samples: int | None, report: Path | None, progress: bool) -> Result:
    """Show the table fault x product."""
    from synthgen.verify.self_test import PRODUCTS, WITNESSES
    from synthgen.verify.self_test import self_test as run

    found = run(directory, 2 if samples is None else samples, progress=progress)
    payload: dict[str, Any] = found.to_json()
    _save(report, payload)
    by_fault: dict[str, list[str]] = {}
    for cell in found.cells:
        by_fault.setdefault(cell.fault, []).append(_word(cell))
    lines = columns([["fault", *PRODUCTS], *([name, *words] for name, words in by_fault.items())])
    reasons: dict[str, list[str]] = {}
    for cell in found.cells:
        if cell.reason:
            reasons.setdefault(f"{cell.product}: {cell.reason}", []).append(cell.fault)
    lines += ["", "not observable:"]
    lines += [f"  {reason}: {', '.join(faults)}" for reason, faults in reasons.items()]
    lines += [
        f"  {cell.product}, {n} of {n + cell.of} samples: {why}: {cell.fault}"
        for cell in found.cells
        if cell.of
        for why, n in cell.unjudged.items()
    ]
    used = sorted({cell.check for cell in found.cells if cell.check})
    lines += ["", "independent witnesses:", *(f"  {c}: {WITNESSES.get(c, '')}" for c in used), ""]
    alarms = found.false_alarms
    lines.append(f"{len(alarms)} false alarms on {found.clean_samples} clean samples")
    lines += list(alarms)
    lines += [f"MISSED: {c.fault} / {c.product}, samples {', '.join(map(str, c.missed))}"
              for c in found.cells if not c.ok]  # fmt: skip
    return Result(payload, lines, DONE if found.ok else FAILED)


def _word(cell: Cell) -> str:
    """One cell in words."""
    if not cell.of:
        return "not observable"
    unjudged = sum(cell.unjudged.values())
    beside = f" ({unjudged} not judged)" if unjudged else ""
    return f"{cell.caught}/{cell.of} {cell.check}{beside}".replace("  ", " ")


def _save(report: Path | None, payload: dict[str, Any]) -> None:
    if report is not None:
        text = json.dumps(finite(payload), indent=2, allow_nan=False)
        report.write_text(text + "\n", encoding="utf-8")


def _line(failure: Failure) -> str:
    """One failure in words; sample -1 is the corpus, view -1 the whole sample."""
    place = "corpus" if failure.sample < 0 else f"sample {failure.sample}"
    place += f", view {failure.view}" if failure.view >= 0 else ""
    numbers = f"{failure.value:.6g}, at most {failure.limit:.6g}"
    return f"{place}: {failure.check} ({numbers}): {failure.message}"
