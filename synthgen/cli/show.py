"""``synthgen show``: everything about one sample."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from synthgen.cli.options import CorpusDir, Json
from synthgen.cli.output import DONE, FAILED, Result
from synthgen.errors import CorpusError

Index = Annotated[int, typer.Option("--sample", metavar="I", min=0, help="Position in the corpus.")]
Pictures = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Folder of the pictures; DIR/show by default."),
]
Remake = Annotated[bool, typer.Option("--remake", help="Render it again and compare.")]


def show(
    directory: CorpusDir,
    sample: Index,
    remake: Remake = False,
    out: Pictures = None,
    as_json: Json = False,
) -> Result:
    """Show everything about one sample; --remake renders it again and compares."""
    from synthgen.corpus import open_corpus
    from synthgen.corpus.show import describe

    count = len(open_corpus(directory))
    if sample >= count:
        raise CorpusError(f"--sample {sample}: {directory} holds samples 0 to {count - 1}")
    payload = describe(directory, sample, remake=remake, out=out)
    same = payload.get("remake", {}).get("same", True)
    lines = [f"{name}: {_word(value)}" for name, value in payload.items()]
    return Result(payload, lines, DONE if same else FAILED)


def _word(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
