"""``synthgen generate``: render a corpus; the same command resumes it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

from synthgen.cli.options import ConfigName, Json, OutDir, Samples, Seed, Sets, configured
from synthgen.cli.output import Result
from synthgen.errors import ConfigError

Workers = Annotated[int, typer.Option("--workers", metavar="W", min=1, help="Processes.")]
Shards = Annotated[
    str | None,
    typer.Option("--shards", metavar="A:B", help="Only the shards A, A+1 .. B-1 (for clusters)."),
]


def generate(
    config: ConfigName,
    out: OutDir,
    samples: Samples = None,
    seed: Seed = None,
    workers: Workers = 1,
    shards: Shards = None,
    sets: Sets = None,
    as_json: Json = False,
) -> Result:
    """Plan and render a corpus. Run the same command again to resume or to grow it."""
    from synthgen.corpus.runner import generate as run

    loaded = configured(config, sets, samples, seed)
    wanted = shard_range(shards)
    with progress_bar(visible=not as_json) as progress:
        summary = run(loaded, out, workers=workers, shards=wanted, progress=progress)
    payload = summary.to_json()
    return Result(payload, [f"{name}: {value}" for name, value in payload.items()])


def shard_range(text: str | None) -> tuple[int, int] | None:
    """Parse ``A:B``; either may be left out of ``A:`` and ``:B`` only together with the colon.

    Raises
    ------
    ConfigError
    """
    if text is None:
        return None
    first, colon, last = text.partition(":")
    if not (colon and first.isascii() and first.isdigit() and last.isascii() and last.isdigit()):
        raise ConfigError(f"--shards {text}: write A:B, for example 0:8 for shards 0 to 7")
    if int(first) >= int(last):
        raise ConfigError(f"--shards {text} is empty; the second number must exceed the first")
    return int(first), int(last)


@contextmanager
def progress_bar(visible: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Give a ``progress(done, total)`` that draws a bar on stderr, or None where nobody looks."""
    if not visible or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    with Progress(
        "samples", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=Console(stderr=True), transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task("samples", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
