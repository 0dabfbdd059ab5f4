"""Options that several verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from synthgen.config import Config

ConfigName = Annotated[
    str, typer.Argument(metavar="CONFIG", help="A preset's name or the path of a .yaml file.")
]
CorpusDir = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a corpus.")]
OutDir = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the corpus.")]
Samples = Annotated[
    int | None,
    typer.Option("--samples", metavar="N", help="Number of samples; otherwise the config's."),
]
Seed = Annotated[
    int | None, typer.Option("--seed", metavar="S", help="Seed; otherwise the config's.")
]
Sets = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="A.B=C", help="Override one key; may be given again."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def configured(
    name: str, sets: list[str] | None, samples: int | None = None, seed: int | None = None
) -> Config:
    """Load a configuration with the overrides of the command line."""
    from synthgen.config import load_config

    given = list(sets or [])
    given += [f"samples={samples}"] if samples is not None else []
    given += [f"seed={seed}"] if seed is not None else []
    return load_config(name, given)
