"""``synthgen bench``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from synthgen.cli import bench
from synthgen.cli.main import main

SOURCE = """
from __future__ import annotations
from dataclasses import dataclass

@dataclass
class Row:
    name: str

def run():
    return {"title": "Speed", "columns": ["what", "s"], "rows": [["ours", 0.12345]], "notes": ["n"]}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "speed.py").write_text(SOURCE)
    (tmp_path / "__init__.py").touch()
    monkeypatch.setattr(bench, "FOLDER", tmp_path)
    return tmp_path


def test_smoke(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = folder / "new" / "report.json"
    assert main(["bench", "speed", "--report", str(report)]) == 0
    assert capsys.readouterr().out == "Speed\n\nwhat  s\nours  0.123\nn\n"
    assert json.loads(report.read_text())["rows"] == [["ours", 0.12345]]


def test_edge_unknown(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "sped"]) == 2
    assert "did you mean 'speed'" in capsys.readouterr().err


def test_edge_no_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench, "FOLDER", tmp_path / "none")
    assert main(["bench", "speed"]) == 2
    assert "checkout" in capsys.readouterr().err


PARTED = """
def run(rows=(), pictures="own"):
    return {"title": "T", "columns": ["rows", "to"], "rows": [["+".join(rows), str(pictures)]]}
"""


def test_properties_rows_and_pictures(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "parted.py").write_text(PARTED)
    assert main(["bench", "parted", "--rows", "a,b"]) == 0
    assert "a+b   own" in capsys.readouterr().out
    assert main(["bench", "parted", "--report", str(folder / "r.json")]) == 0
    assert "r_pictures" in capsys.readouterr().out
    assert main(["bench", "speed", "--rows", "a"]) == 2
    assert "no rows to choose" in capsys.readouterr().err


def test_edge_unknown_rows(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "scanner", "--rows", "plane"]) == 2
    assert "did you mean 'planes'" in capsys.readouterr().err
