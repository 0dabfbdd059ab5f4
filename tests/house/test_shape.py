"""The shape of the code: no drawers for odds and ends, modules and functions of readable size."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

import synthgen

PACKAGE = Path(synthgen.__file__).parent
ROOT = PACKAGE.parent
FILES = sorted(PACKAGE.rglob("*.py"))
DRAWERS = {"utils", "util", "helpers", "helper", "common", "misc"}
MODULE_WALL, FUNCTION_WALL = 400, 60


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


class Shape(NamedTuple):
    """What the tests ask of a module: trees would weigh on every collection of garbage."""

    docstring: str | None
    lines: int
    functions: dict[str, int]
    globals: list[int]


@cache
def shape_of(path: Path) -> Shape:
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    functions, globals_ = {}, []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            size = (node.end_lineno or node.lineno) - node.lineno + 1
            functions[f"{node.name} of line {node.lineno}"] = size
        elif isinstance(node, ast.Global):
            globals_.append(node.lineno)
    return Shape(ast.get_docstring(tree), len(source.splitlines()), functions, globals_)


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_names(path: Path) -> None:
    assert path.stem not in DRAWERS
    assert not path.stem.lower().endswith("utility")


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_sizes(path: Path) -> None:
    assert shape_of(path).lines <= MODULE_WALL
    for name, size in shape_of(path).functions.items():
        assert size <= FUNCTION_WALL, f"{name} has {size} lines"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_every_module_says_what_it_is(path: Path) -> None:
    assert shape_of(path).docstring


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_no_module_state_that_changes(path: Path) -> None:
    assert not shape_of(path).globals, "lines with `global`"


def test_properties_presets_are_short() -> None:
    for path in sorted((ROOT / "configs").glob("*.yaml")):
        assert len(path.read_text().splitlines()) < 60, path.name


def test_properties_a_test_file_per_room() -> None:
    rooms = {p.name for p in PACKAGE.iterdir() if (p / "__init__.py").is_file()}
    tested = {p.name for p in (ROOT / "tests").iterdir() if p.is_dir()}
    assert rooms <= tested, f"no tests for {sorted(rooms - tested)}"
