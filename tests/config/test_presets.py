"""Finding presets and files."""

from __future__ import annotations

from pathlib import Path

import pytest

from synthgen.config import presets
from synthgen.config.presets import data_folder, find_config, list_presets
from synthgen.errors import ConfigError


def test_smoke() -> None:
    assert {"hand_rgbd", "fixtures"} <= set(list_presets())
    assert data_folder("scenes").is_dir()


def test_reference_relative_to_the_file_that_extends(tmp_path: Path) -> None:
    (tmp_path / "x.yaml").touch()
    assert find_config("x.yaml", tmp_path) == tmp_path / "x.yaml"
    assert find_config("./x.yaml", tmp_path).samefile(tmp_path / "x.yaml")


def test_reference_installed_data_come_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside = tmp_path / "synthgen" / "_data" / "configs"
    inside.mkdir(parents=True)
    (tmp_path / "configs").mkdir()
    monkeypatch.setattr(presets, "PACKAGE", tmp_path / "synthgen")
    assert data_folder("configs") == inside


@pytest.mark.parametrize("name", ["hand_rgb", "nothing.yaml", "no/such"])
def test_edge_missing(name: str) -> None:
    with pytest.raises(ConfigError, match=r"hand_rgbd|no configuration file"):
        find_config(name)


def test_edge_damaged_installation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(presets, "PACKAGE", tmp_path / "synthgen")
    with pytest.raises(ConfigError, match="install it again from a checkout"):
        data_folder("configs")
