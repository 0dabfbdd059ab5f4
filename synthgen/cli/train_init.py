"""``synthgen train-init``: train the initialiser that cold fits of a hand model begin with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from synthgen.cli.options import Json
from synthgen.cli.output import Result

Model = Annotated[str, typer.Argument(metavar="MODEL", help="A hand model's name or path.")]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="Instead of the user's cache.")
]
Seconds = Annotated[
    float, typer.Option("--seconds", metavar="S", min=1.0, help="CPU seconds of training.")
]
Hands = Annotated[int, typer.Option("--hands", metavar="N", min=100, help="Hands to learn from.")]


def train_init(
    model: Model,
    out: Out = None,
    seconds: Seconds = 300.0,
    hands: Hands = 8000,
    as_json: Json = False,
) -> Result:
    """Train the start of a hand model's cold fits, in a few CPU minutes; tied to its digest."""
    from synthgen.models import load
    from synthgen.registration.initialiser import initialiser_path
    from synthgen.torch.train_initialiser import train_initialiser

    hand = load(model)

    def say(line: str) -> None:
        typer.echo(line, err=True)

    trained = train_initialiser(hand, cpu_seconds=seconds, hands=hands, say=say)
    path = initialiser_path(hand) if out is None else out
    trained.initialiser.save(path)
    error = {name: 1e3 * value for name, value in trained.error_m.items()}
    payload = {"file": str(path), "weights": trained.initialiser.n_weights, "steps": trained.steps,
               "model_digest": trained.initialiser.digest, "held_out_error_mm": error}  # fmt: skip
    line = f"{path}: {trained.steps} steps, held-out keypoints off by {error['median']:.1f} mm"
    return Result(payload, [line])
