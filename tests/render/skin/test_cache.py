"""Where the cache is."""

from __future__ import annotations

from pathlib import Path

import pytest

from synthgen.render.skin.cache import cache_folder


def test_reference_the_variable_wins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SYNTHGEN_CACHE", str(tmp_path))
    assert cache_folder("skin") == tmp_path / "skin"


@pytest.mark.parametrize(
    ("platform", "variable", "tail"),
    [
        ("linux", "XDG_CACHE_HOME", "synthgen/skin"),
        ("win32", "LOCALAPPDATA", "synthgen/skin"),
    ],
)
def test_reference_the_platforms_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, platform: str, variable: str, tail: str
) -> None:
    monkeypatch.delenv("SYNTHGEN_CACHE", raising=False)
    monkeypatch.setattr("sys.platform", platform)
    monkeypatch.setenv(variable, str(tmp_path))
    assert cache_folder("skin") == tmp_path / tail


def test_edge_home_where_nothing_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SYNTHGEN_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert cache_folder("skin") == Path.home() / ".cache" / "synthgen" / "skin"
    monkeypatch.setattr("sys.platform", "darwin")
    assert cache_folder("x") == Path.home() / "Library" / "Caches" / "synthgen" / "x"
