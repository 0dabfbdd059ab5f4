"""``synthgen doctor``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import pytest

from synthgen.cli import doctor
from synthgen.cli.main import main
from synthgen.errors import ModelError
from synthgen.scanner import list_rigs

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
    assert "No module named 'scipy' (run `pip install" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["hand5", "foot10"])
def test_smoke_rig(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "rig.png"
    assert main(["doctor", "rig", name, "--out", str(picture), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["problems"] == []
    assert report["seen_by_one"] > 0.9
    for unit in report["units"]:
        near, far = unit["depth_m"]
        assert 0.2 < near < far < 1.2
        # One pixel of disparity at depth z is z^2 / (f B), and a pixel is z / f.
        size, step = unit["gsd_m"][1], unit["depth_per_px_m"][1]
        assert step / size == pytest.approx((near + far) / 2 / unit["baseline_m"], rel=1e-9)
    image = cv2.imread(str(picture))
    assert image is not None
    assert image.std() > 5
    assert main(["doctor", "rig", name, "--out", str(picture)]) == 0
    assert "GSD mm" in capsys.readouterr().out


def test_edge_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "rig"]) == 2
    assert "synthgen doctor rig NAME" in capsys.readouterr().err
    assert main(["doctor", "rag", "mini"]) == 2
    assert main(["doctor", "rig", "mni"]) == 2
    assert "did you mean 'mini'" in capsys.readouterr().err
    text = list_rigs()["mini"].read_text(encoding="utf-8")
    blind = tmp_path / "blind.yaml"
    blind.write_text(text.replace("distance_m: 0.6}\n  right", "distance_m: 0.6, slot: 3, "
                                  "target_m: [3, 0, 0]}\n  right"))  # fmt: skip
    assert main(["doctor", "rig", str(blind), "--out", str(tmp_path / "b.png")]) == 1
    told = capsys.readouterr().out
    assert "unit front sees nothing of the working volume" in told
    assert "unit front: black speckle: projectors front/0 give" not in told
    dark = tmp_path / "dark.yaml"
    dark.write_text(text.replace("irradiance: 0.5", "irradiance: 0.0001"))
    assert main(["doctor", "rig", str(dark), "--out", str(tmp_path / "d.png")]) == 1
    assert "unit right: black speckle: projectors front/0, right/0 give" in capsys.readouterr().out
    wide = tmp_path / "wide.yaml"
    wide.write_text(text.replace("distance_m: 0.6}", "distance_m: 0.01}"))
    assert main(["doctor", "rig", str(wide)]) == 2
    assert "wide.yaml: distortion" in capsys.readouterr().err
