"""``synthgen generate``: its options; the job itself is tested in tests/promises."""

from __future__ import annotations

from pathlib import Path

import pytest

from synthgen.cli.generate import shard_range
from synthgen.cli.main import main
from synthgen.errors import ConfigError


def test_smoke() -> None:
    assert shard_range(None) is None
    assert shard_range("0:8") == (0, 8)


@pytest.mark.parametrize("text", ["", "3", ":", "3:", ":3", "a:b", "3:3", "4:3", "-1:2", "1:2:3"])
def test_edge_shards(text: str) -> None:
    with pytest.raises(ConfigError, match="--shards"):
        shard_range(text)


def test_edge_a_missing_denoiser_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Found missing, it is said before anything is made; here an occupied folder ends the run."""
    monkeypatch.setattr("synthgen.cli.generate.find_spec", lambda name: None)
    (tmp_path / "mine.txt").write_text("not a corpus")
    assert main(["generate", "hand_full", "--out", str(tmp_path), "--samples", "1"]) == 2
    assert "pip install mitsuba-oidn" in capsys.readouterr().err
