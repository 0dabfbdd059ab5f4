"""``synthgen doctor``."""

from __future__ import annotations

import json
from typing import Any

import pytest

from synthgen.cli import doctor
from synthgen.cli.main import main
from synthgen.errors import ModelError

GOOD = {
    "cuda": False,
    "llvm": {"path": "/lib/libLLVM.so", "version": "23.1.4"},
    "variant": "llvm_ad_rgb",
    "problem": None,
    "versions": {},
}


@pytest.fixture
def backend(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    report: dict[str, Any] = dict(GOOD)
    monkeypatch.setattr("synthgen.render.backend.report", lambda: report)
    return report


def test_smoke(backend: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    for word in ("llvm_ad_rgb", "23.1.4", "cc0-hand: CC0", "hand_rgbd", "mitsuba"):
        assert word in out


def test_reference_json(backend: dict[str, Any], capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 0
    payload = json.loads(capfd.readouterr().out)
    assert payload["ok"] is True
    assert payload["problems"] == []
    assert payload["backend"] == backend


def test_edge_no_back_end(backend: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    backend.update(variant=None, llvm=None, problem="no usable LLVM found. Install it with ...")
    assert main(["doctor"]) == 1
    assert "cannot run:\nno usable LLVM found. Install it with" in capsys.readouterr().out


def test_edge_library_missing(
    backend: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "LIBRARIES", ("numpy", "no-such-library"))
    assert main(["doctor"]) == 1
    assert "pip install no-such-library" in capsys.readouterr().out


def test_edge_shipped_model_broken(
    backend: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ModelError("cc0-hand.npz: not a readable model archive")

    monkeypatch.setattr("synthgen.models.load", broken)
    assert main(["doctor"]) == 1
    assert "not a readable model archive" in capsys.readouterr().out


def test_edge_a_doctor_does_not_die(
    backend: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def gone(*_: object) -> None:
        raise ImportError("No module named 'scipy'")

    monkeypatch.setattr("synthgen.models.list_models", gone)
    assert main(["doctor"]) == 1
    assert "No module named 'scipy' (pip install" in capsys.readouterr().out
