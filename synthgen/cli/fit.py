"""``synthgen fit``: register scans of hands and bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any
from zipfile import BadZipFile, is_zipfile

import typer

from synthgen.cli.fit_batch import Options, fit_batch
from synthgen.cli.options import Json
from synthgen.cli.output import Result
from synthgen.errors import ConfigError

Scans = Annotated[
    list[Path],
    typer.Argument(metavar="SCAN...", help="PLY, OBJ, GLB or XYZ files; one hand or body each."),
]
Model = Annotated[
    str, typer.Option("--model", metavar="NAME", help="A hand or body model's name or path.")
]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the results.")]
Hand = Annotated[
    str, typer.Option("--hand", metavar="SIDE", help="auto, left or right (hand models only).")
]
Start = Annotated[
    str, typer.Option("--start", metavar="cold|FILE", help="cold, or a fit's .npz to start from.")
]
Coupled = Annotated[
    bool, typer.Option("--coupled", help="Also free the mesh, for detail that the model lacks.")
]
PresetName = Annotated[
    str,
    typer.Option(
        "--preset", metavar="NAME", help="fast, accurate or paper (the last two: hand models only)."
    ),
]
Units = Annotated[str, typer.Option("--units", metavar="UNIT", help="auto, m, mm, cm or inch.")]
Smooth = Annotated[
    bool,
    typer.Option(
        "--smooth",
        help="The scanned surface is smooth through the model's vertices, as corpora draw it, not "
        "its flat triangles (hand models only).",
    ),
]
Tracked = Annotated[
    bool, typer.Option("--sequence", help="Scans are frames of one subject: track it.")
]

Template = Annotated[
    str,
    typer.Option(
        "--template",
        metavar="WORD",
        help="With --sequence: track the subject's own template, yes, no or auto (where the model's"
        " shape is not the subject's).",
    ),
]
Again = Annotated[
    bool, typer.Option("--again", help="Also fit what the same command has done already.")
]


def fit(
    scans: Scans,
    out: Out,
    model: Model = "cc0-hand",
    hand: Hand = "auto",
    start: Start = "cold",
    coupled: Coupled = False,
    preset: PresetName = "fast",
    units: Units = "auto",
    smooth: Smooth = False,
    sequence: Tracked = False,
    template: Template = "auto",
    again: Again = False,
    as_json: Json = False,
) -> Result:
    """Fit a hand or body model to scans; parameters, mesh, picture and report go to --out.

    The same command goes on where it was stopped. Exit code 1: a fit failed.
    """
    if sequence:
        from synthgen.cli.fit_sequence import fit_sequence

        if preset != "fast":
            raise ConfigError(f"--preset {preset} is for single scans; leave it out of --sequence")
        if smooth:
            raise ConfigError("--smooth is for single scans; leave it out of --sequence")
        return fit_sequence(scans, out, model, hand, _start(start), coupled=coupled,
                            template=template, units=units, again=again,
                            progress=not as_json)  # fmt: skip
    if template != "auto":
        raise ConfigError(f"--template {template} is for --sequence; a single scan has no frames")
    options = Options(hand, _start(start), coupled, preset, units, smooth)
    return fit_batch(scans, out, model, options, again=again, progress=not as_json)


def _start(word: str) -> Any:
    import numpy as np

    if word == "cold":
        return "cold"
    told = f"--start {word!r}: expected cold or a fit's .npz (shape, pose, translation)"
    if not Path(word).is_file():
        raise ConfigError(f"{told}: no such file")
    if not is_zipfile(word):
        raise ConfigError(f"{told}: this file is no .npz")
    try:
        with np.load(word, allow_pickle=False) as stored:
            last = ("expression",) if "expression" in stored else ()
            found = tuple(stored[key] for key in ("shape", "pose", "translation", *last))
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise ConfigError(f"{told}: {error}") from error
    if not all(part.dtype.kind in "fiu" for part in found):
        raise ConfigError(f"{told}: it holds {', '.join(str(p.dtype) for p in found)}, no numbers")
    return found
