"""``synthgen generate``: render a corpus; the same command resumes it."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated

import typer

from synthgen.cli.options import ConfigName, Json, OutDir, Samples, Seed, Sets, configured
from synthgen.cli.output import Result
from synthgen.errors import ConfigError

NO_DENOISER = (
    "render.denoise=auto finds no denoiser: pictures stay noisy, and the plan says so; run `pip "
    "install mitsuba-oidn`, or set a higher render.spp"
)

ELSEWHERE = (
    "another run is still making some of these shards; when it has ended, the same command tells "
    "whether all are there"
)

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

    loaded, wanted = configured(config, sets, samples, seed), shard_range(shards)
    if loaded.render.denoise == "auto" and find_spec("mitsuba_oidn") is None:
        typer.echo(NO_DENOISER, err=True)
    summary = run(loaded, out, workers=workers, shards_range=wanted, progress=not as_json)
    payload = summary.to_json()
    lines = [f"{name}: {value}" for name, value in payload.items()]
    if summary.shards_elsewhere:
        lines.append(ELSEWHERE)
    return Result(payload, lines)


def shard_range(text: str | None) -> tuple[int, int] | None:
    """Parse ``A:B``, two whole numbers, the second larger.

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
