"""``synthgen config``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from synthgen.cli.main import main
from synthgen.config import Config, config_hash, load_config


def test_smoke_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "schema"]) == 0
    assert json.loads(capsys.readouterr().out) == Config.model_json_schema()


def test_reference_show_is_a_config_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "show", "fixtures", "--set", "seed=4"]) == 0
    (tmp_path / "x.yaml").write_text(capsys.readouterr().out)
    assert load_config(tmp_path / "x.yaml") == load_config("fixtures", ["seed=4"])


def test_reference_json(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "show", "hand_rgbd", "--json"]) == 0
    payload = json.loads(capfd.readouterr().out)
    assert payload["hash"] == config_hash(load_config("hand_rgbd"))
    assert Config.model_validate_json(json.dumps(payload["config"])) == Config()
