"""The plan: one fully resolved row per sample, written before anything is rendered."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.progress import Progress

from synthgen.config import Config, config_hash, resolved_yaml
from synthgen.corpus import atomic
from synthgen.corpus.manifest import engine
from synthgen.errors import CorpusError
from synthgen.sampling.draw import draw_sample
from synthgen.sampling.spec import SampleSpec

PLAN = "plan.jsonl"
ENGINE = "engine.json"
CONFIG = "config.resolved.yaml"


def write_plan(config: Config, out: Path, *, progress: bool = True) -> Path:
    """Resolve every sample and write the plan; an existing one is kept and lengthened.

    Parameters
    ----------
    config : Config
    out : Path
        The corpus folder.
    progress : bool
        Show a progress bar on a terminal.

    Returns
    -------
    Path
        ``out/plan.jsonl``.

    Raises
    ------
    CorpusError
        If the folder holds a corpus of another config, back end or library version.
    """
    atomic.make_folder(out)
    _claim(config, out)
    path = out / PLAN
    rows = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
    if len(rows) >= config.samples:
        return path
    with Progress(transient=True, disable=not progress) as bar:
        task = bar.add_task("planning", total=config.samples, completed=len(rows))
        for index in range(len(rows), config.samples):
            row = draw_sample(config, index).to_json()
            rows.append(json.dumps(row, sort_keys=True, separators=(",", ":")).encode() + b"\n")
            bar.advance(task)
    atomic.replace(path, b"".join(rows))
    return path


def _claim(config: Config, out: Path) -> None:
    """Refuse a folder that belongs to another config or was made by another engine."""
    mine = {
        "config_hash": config_hash(config),
        **engine(config.render.variant, config.render.denoise),
    }
    path = out / ENGINE
    if path.is_file():
        theirs = _read_json(path)
        differing = [k for k in mine if theirs.get(k) != mine[k]]
        if differing:
            said = "; ".join(f"{k} was {theirs.get(k)}, is {mine[k]}" for k in differing)
            raise CorpusError(
                f"{out} holds a corpus of another making ({said}); choose another --out, or "
                "restore what it was made with"
            )
    else:
        if any(path for path in out.iterdir() if not path.name.startswith(".")):
            raise CorpusError(f"{out} is not empty and holds no corpus; choose another --out")
        atomic.replace(path, json.dumps(mine, sort_keys=True, indent=1).encode())
    atomic.replace(out / CONFIG, resolved_yaml(config).encode())


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise CorpusError(f"{path}: unreadable ({error})") from None
    return content if isinstance(content, dict) else {}


def read_plan(out: Path, first: int = 0, stop: int | None = None) -> list[SampleSpec]:
    """Read rows of the plan.

    Raises
    ------
    CorpusError
        If the plan is missing, or a row is damaged (the row is named).
    """
    path = out / PLAN
    if not path.is_file():
        raise CorpusError(f"{path} is missing; is {out} a corpus?")
    rows = path.read_bytes().splitlines()[first:stop]
    specs = []
    for number, row in enumerate(rows, start=first):
        try:
            specs.append(SampleSpec.from_json(json.loads(row)))
        except (ValueError, KeyError, TypeError) as error:
            raise CorpusError(f"{path}: row {number} is damaged ({error})") from None
    return specs
