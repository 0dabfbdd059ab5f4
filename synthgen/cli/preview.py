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
    typer.Option("--sheet", metavar="FILE", help="Write the pictures alone, as one JPEG sheet."),
]


def preview(
    directory: CorpusDir, out: Page = None, sheet: Sheet = None, as_json: Json = False
) -> Result:
    """Write one static HTML file with pictures, overlays and histograms of a corpus."""
    from synthgen.corpus.gallery import contact_sheet, write_gallery

    if sheet is not None:
        contact_sheet(directory, sheet)
        return Result({"sheet": str(sheet)}, [f"wrote {sheet}"])
    page = out or directory / "gallery.html"
    write_gallery(directory, page)
    return Result({"gallery": str(page)}, [f"open {page} in a browser"])
