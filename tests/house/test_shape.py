"""The shape of the code: no drawers for odds and ends, modules and functions of readable size."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import synthgen

PACKAGE = Path(synthgen.__file__).parent
ROOT = PACKAGE.parent
FILES = sorted(PACKAGE.rglob("*.py"))
DRAWERS = {"utils", "util", "helpers", "helper", "common", "misc"}
MODULE_WALL, FUNCTION_WALL = 400, 60


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_names(path: Path) -> None:
    assert path.stem not in DRAWERS
    assert not path.stem.lower().endswith("utility")


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_sizes(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    assert len(source.splitlines()) <= MODULE_WALL
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            size = (node.end_lineno or node.lineno) - node.lineno + 1
            assert size <= FUNCTION_WALL, f"{node.name} has {size} lines"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_every_module_says_what_it_is(path: Path) -> None:
    assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_no_module_state_that_changes(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        assert not isinstance(node, ast.Global), f"line {node.lineno}: `global`"


def test_properties_presets_are_short() -> None:
    for path in sorted((ROOT / "configs").glob("*.yaml")):
        assert len(path.read_text().splitlines()) < 60, path.name


def test_properties_a_test_file_per_room() -> None:
    rooms = {p.name for p in PACKAGE.iterdir() if (p / "__init__.py").is_file()}
    tested = {p.name for p in (ROOT / "tests").iterdir() if p.is_dir()}
    assert rooms <= tested, f"no tests for {sorted(rooms - tested)}"
