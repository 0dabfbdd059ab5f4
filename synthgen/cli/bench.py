"""``synthgen bench``: run one of the checkout's benchmarks."""

from __future__ import annotations

import importlib.util
import inspect
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
    Path | None,
    typer.Option("--report", metavar="FILE", help="Write the table as JSON, pictures beside it."),
]
Rows = Annotated[
    str,
    typer.Option(
        "--rows", metavar="A,B,...", help="Only these parts, where the benchmark has any."
    ),
]


def bench(name: Name, rows: Rows = "", report: Report = None, as_json: Json = False) -> Result:
    """Run a benchmark and print its table; needs a checkout of the repository."""
    pictures = None if report is None else report.with_name(f"{report.stem}_pictures")
    if report is not None:
        report.parent.mkdir(parents=True, exist_ok=True)
    if not as_json:
        typer.echo(f"{name}: running; the table comes at the end", err=True)
    table = run(name, tuple(filter(None, rows.split(","))), pictures)
    if report is not None:
        report.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    cells = [[_cell(value) for value in row] for row in table["rows"]]
    lines = [table["title"], "", *columns([table["columns"], *cells]), *table.get("notes", [])]
    return Result(table, lines)


def run(name: str, rows: tuple[str, ...] = (), pictures: Path | None = None) -> dict[str, Any]:
    """Run ``benchmarks/NAME.py`` and return its table: title, columns, rows, notes.

    Parameters
    ----------
    name : str
    rows : tuple of str
        Parts to run, of a benchmark that has some to choose from; empty runs all.
    pictures : Path, optional
        Folder for the pictures of a benchmark that draws some; default its own.

    Raises
    ------
    ConfigError
        If there is no such benchmark or part, or this is no checkout.
    """
    known = sorted(path.stem for path in FOLDER.glob("[!_]*.py"))
    if not known:
        raise ConfigError("benchmarks are not installed; run `make bench` in a checkout")
    if name not in known:
        raise ConfigError(f"no benchmark {name!r}{nearest(name, known)}; known: {', '.join(known)}")
    module = _load(FOLDER / f"{name}.py")
    takes = inspect.signature(module.run).parameters
    asked: dict[str, Any] = {}
    if rows:
        if "rows" not in takes:
            raise ConfigError(f"benchmark {name} has no rows to choose from; leave --rows out")
        asked["rows"] = rows
    if pictures is not None and "pictures" in takes:
        asked["pictures"] = pictures
    table: dict[str, Any] = module.run(**asked)
    return table


def _load(path: Path) -> ModuleType:
    if str(path.parents[1]) not in sys.path:  # benchmarks may share parts
        sys.path.insert(0, str(path.parents[1]))
    spec = importlib.util.spec_from_file_location(f"benchmarks.{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
