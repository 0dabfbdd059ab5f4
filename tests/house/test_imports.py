"""Who may import whom: the table of rooms, and who may touch the heavy libraries."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

import synthgen

PACKAGE = Path(synthgen.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))

_BELOW_SAMPLING = {"geometry", "models", "scene", "config"}
_BELOW_RENDER = _BELOW_SAMPLING | {"sampling"}
_BELOW_CORPUS = _BELOW_RENDER | {"cc0", "render", "scanner", "registration"}
_BELOW_VERIFY = _BELOW_CORPUS | {"corpus"}
MAY_IMPORT: dict[str, set[str]] = {
    "config": set(),
    "geometry": set(),
    "models": {"geometry"},
    "scene": {"geometry", "models"},
    "sampling": _BELOW_SAMPLING,
    "cc0": _BELOW_RENDER,
    "render": _BELOW_RENDER,
    "scanner": _BELOW_RENDER | {"render"},
    "registration": {"models", "geometry", "sampling"},
    "corpus": _BELOW_CORPUS,
    "verify": _BELOW_VERIFY,
    "exporters": _BELOW_VERIFY,
    "torch": _BELOW_VERIFY,
    "experiments": _BELOW_VERIFY | {"verify"},
    "cli": _BELOW_VERIFY | {"verify", "exporters", "torch", "experiments"},
}
# The front door and the errors belong to no room.
DOOR = {"__init__", "__main__", "errors"}
HEAVY_HOME = {
    "mitsuba": ("render/", "scanner/"),
    "drjit": ("render/", "scanner/"),
    "torch": ("torch/", "verify/", "models/as_torch", "cc0/feet"),  # cc0: training only
    "kornia": ("torch/", "verify/"),
}


@cache
def imported(path: Path) -> frozenset[str]:
    """Return the dotted names of every import of a file, lazy and typing-only ones included."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def room_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else path.stem


def own_rooms(names: frozenset[str]) -> set[str]:
    return {name.split(".")[1] for name in names if name.startswith("synthgen.")}


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_arrows_of_the_table(path: Path) -> None:
    room = room_of(path)
    if room in DOOR:
        return
    assert room in MAY_IMPORT, f"{name_of(path)}: no such room; add it to the design first"
    allowed = MAY_IMPORT[room] | {room, "errors", "__version__"}
    found = own_rooms(imported(path)) - allowed
    assert not found, f"{name_of(path)} imports {sorted(found)}; {room} may import {allowed}"


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_properties_heavy_libraries_stay_at_home(path: Path) -> None:
    for name in imported(path):
        home = HEAVY_HOME.get(name.split(".")[0])
        if home is not None:
            assert name_of(path).startswith(home), f"{name_of(path)} imports {name}"


def test_properties_the_gate_is_the_first_to_import_mitsuba() -> None:
    """No module imports mitsuba or drjit at its top: the gate must choose LLVM before that."""
    for path in FILES:
        if not any(name.split(".")[0] in ("mitsuba", "drjit") for name in imported(path)):
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            heavy = [n for n in names if n.split(".")[0] in ("mitsuba", "drjit")]
            assert not heavy, f"{name_of(path)} imports {heavy} at its top"


def test_edge_the_walker_sees_what_it_must(tmp_path: Path) -> None:
    source = "import torch.nn\ndef f():\n    from synthgen.render import backend\n"
    (tmp_path / "x.py").write_text(source)
    names = imported(tmp_path / "x.py")
    assert own_rooms(names) == {"render"}
    assert "torch.nn" in names
