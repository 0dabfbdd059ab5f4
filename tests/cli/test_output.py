"""Results and their printing."""

from __future__ import annotations

import json
import os

import pytest

from synthgen.cli.output import Result, columns, stdout_kept_clean


def test_smoke_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert Result({"a": 1}, ["one", "two"], code=1).emit(False) == 1
    assert capsys.readouterr().out == "one\ntwo\n"


def test_reference_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert Result({"a": [1, "é"]}).emit(True) == 0
    assert json.loads(capsys.readouterr().out) == {"a": [1, "é"]}


def test_edge_nan_becomes_null(capsys: pytest.CaptureFixture[str]) -> None:
    Result({"a": [float("nan"), {"b": (1.0, float("-inf"))}]}).emit(True)
    assert json.loads(capsys.readouterr().out) == {"a": [None, {"b": [1.0, None]}]}


def test_shape_columns() -> None:
    assert columns([("a", 1), ("bbb", None)]) == ["a    1", "bbb  None"]


def test_properties_stdout_comes_back(capfd: pytest.CaptureFixture[str]) -> None:
    with stdout_kept_clean(True):
        os.write(1, b"noise\n")
    os.write(1, b"word\n")
    captured = capfd.readouterr()
    assert captured.out == "word\n"
    assert captured.err == "noise\n"
