"""``synthgen preview``: a gallery to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from synthgen.cli.options import CorpusDir, Json
from synthgen.cli.output import Result

Page = Annotated[
    Path | None,
    typer.Option("--out", metavar="FILE", help="HTML file to write; DIR/gallery.html by default."),
]


Sheet = Annotated[
    Path | None,
    typer.Option(
        "--sheet",
        metavar="FILE",
        help="Write the pictures alone, as one JPEG sheet; the page only if --out is given, too.",
    ),
]


def preview(
    directory: CorpusDir, out: Page = None, sheet: Sheet = None, as_json: Json = False
) -> Result:
    """Write one static HTML file with pictures, overlays and histograms of a corpus."""
    from synthgen.corpus.gallery import contact_sheet, write_gallery

    payload, lines = {}, []
    if sheet is not None:
        payload["sheet"] = str(contact_sheet(directory, sheet))
        lines.append(f"wrote {sheet}")
    if sheet is None or out is not None:
        page = write_gallery(directory, out)
        payload["gallery"] = str(page)
        lines.append(f"open {page} in a browser")
    return Result(payload, lines)
