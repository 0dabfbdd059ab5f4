"""``synthgen verify``: recompute every label that can be recomputed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from synthgen.cli.options import CorpusDir, Json
from synthgen.cli.output import DONE, FAILED, Result

if TYPE_CHECKING:
    from synthgen.verify.report import Failure

SHOWN = 20

Some = Annotated[
    int | None, typer.Option("--samples", metavar="N", min=1, help="Check N samples, spread out.")
]
Report = Annotated[
    Path | None, typer.Option("--report", metavar="FILE", help="Write the report as JSON.")
]


def verify(
    directory: CorpusDir, samples: Some = None, report: Report = None, as_json: Json = False
) -> Result:
    """Check hashes and labels of a corpus against the truth it was made from."""
    from synthgen.verify.labels import verify as check

    found = check(directory, samples=samples, progress=not as_json)
    payload = found.to_json()
    if report is not None:
        report.write_text(json.dumps(payload, indent=2) + "\n", encoding="utf-8")
    lines = [_line(failure) for failure in found.failures[:SHOWN]]
    hidden = len(found.failures) - len(lines)
    lines += [f"... and {hidden} more (--report FILE holds all)"] if hidden > 0 else []
    verdict = "ok" if found.ok else f"{len(found.failures)} failures"
    lines.append(f"{directory}: {found.samples} samples, {found.views} views checked: {verdict}")
    return Result(payload, lines, DONE if found.ok else FAILED)


def _line(failure: Failure) -> str:
    """One failure in words; sample -1 is the corpus, view -1 the whole sample."""
    place = "corpus" if failure.sample < 0 else f"sample {failure.sample}"
    place += f", view {failure.view}" if failure.view >= 0 else ""
    numbers = f"{failure.value:.6g}, at most {failure.limit:.6g}"
    return f"{place}: {failure.check} ({numbers}): {failure.message}"
