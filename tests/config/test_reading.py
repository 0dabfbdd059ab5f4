"""Reading YAML that may be wrong or hostile."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from synthgen.config.reading import MAX_BYTES, parse_yaml, read_yaml
from synthgen.errors import ConfigError

BOMB = "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n"


def test_smoke_lines() -> None:
    document = parse_yaml("a: 1\nb:\n  c: [1, 2]\n", "text")
    assert document.content == {"a": 1, "b": {"c": [1, 2]}}
    assert document.lines == {"a": 1, "b": 2, "b.c": 3}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1), ("-3", -3), ("1e-3", 1e-3), ("1E3", 1000.0), (".5", 0.5), ("1.", 1.0),
        ("true", True), ("False", False), ("null", None), ("~", None), ("", None),
        ("on", "on"), ("yes", "yes"), ("1:30", "1:30"), ("2020-01-01", "2020-01-01"),
        ("'1'", "1"), ('"null"', "null"), ("0x10", "0x10"), ("1_000", "1_000"),
    ],
)  # fmt: skip
def test_reference_core_schema(text: str, value: Any) -> None:
    found = parse_yaml(f"k: {text}", "text").content["k"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB, "line 1: anchors"),
        ("a: [1, 2\nb: 3\n", "line 2: unreadable YAML"),
        ("a: 1\na: 2\n", "line 2: key 'a' is given twice"),
        ("a: !!python/object/apply:os.system [ls]\n", "tag"),
        ("a: !mine 3\n", "tag"),
        ("? [1, 2]\n: 3\n", "a key must be a word"),
        ("a: " + "[" * 50 + "]" * 50, "deeper than"),
        ("a: \x07\n", "unreadable YAML"),
        ("a: 1\n---\nb: 2\n", "unreadable YAML"),
    ],
)
def test_edge_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_yaml(text, "text")


def test_edge_files(tmp_path: Path) -> None:
    (tmp_path / "big.yaml").write_bytes(b"#" * (MAX_BYTES + 1))
    (tmp_path / "latin.yaml").write_bytes(b"a: \xe9\n")
    with pytest.raises(ConfigError, match="larger than"):
        read_yaml(tmp_path / "big.yaml")
    with pytest.raises(ConfigError, match="byte 3 is not UTF-8"):
        read_yaml(tmp_path / "latin.yaml")
    with pytest.raises(ConfigError, match="No such file"):
        read_yaml(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="directory"):
        read_yaml(tmp_path)
