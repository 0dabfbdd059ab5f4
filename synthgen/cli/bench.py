"""``synthgen bench``: run one of the checkout's benchmarks."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import typer

from synthgen.cli.options import Json
from synthgen.cli.output import Result, columns
from synthgen.errors import ConfigError, nearest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"

Name = Annotated[str, typer.Argument(metavar="NAME", help="A file of benchmarks/, without .py.")]
Report = Annotated[
    Path | None, typer.Option("--report", metavar="FILE", help="Write the table as JSON.")
]


def bench(name: Name, report: Report = None, as_json: Json = False) -> Result:
    """Run a benchmark and print its table; needs a checkout of the repository."""
    table = run(name)
    if report is not None:
        report.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    rows = [[_cell(value) for value in row] for row in table["rows"]]
    lines = [table["title"], "", *columns([table["columns"], *rows]), *table.get("notes", [])]
    return Result(table, lines)


def run(name: str) -> dict[str, Any]:
    """Run ``benchmarks/NAME.py`` and return its table: title, columns, rows, notes.

    Raises
    ------
    ConfigError
        If there is no such benchmark, or this is no checkout.
    """
    known = sorted(path.stem for path in FOLDER.glob("[!_]*.py"))
    if not known:
        raise ConfigError("benchmarks are not installed; run `make bench` in a checkout")
    if name not in known:
        raise ConfigError(f"no benchmark {name!r}{nearest(name, known)}; known: {', '.join(known)}")
    table: dict[str, Any] = _load(FOLDER / f"{name}.py").run()
    return table


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"benchmarks.{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
