"""Attacks: nothing in a file is ever executed; each ends in one clear error."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import pytest

from synthgen.errors import ModelError
from synthgen.models.pickles import read_pickle


class Calls:
    """Pickles into a call of any function."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.function, self.arguments = function, arguments

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return self.function, self.arguments


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize(
    "attack",
    [
        Calls(os.system, "touch PWNED"),
        Calls(eval, "open('PWNED', 'w')"),
        Calls(exec, "open('PWNED', 'w')"),
        Calls(open, "PWNED", "w"),
        Calls(getattr, os, "system"),
        Calls(__import__, "os"),
    ],
)
def test_edge_attacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, attack: Calls, protocol: int
) -> None:
    monkeypatch.chdir(tmp_path)
    if attack.function is getattr:
        attack = Calls(getattr, "text", "join")
    path = tmp_path / "attack.pkl"
    path.write_bytes(pickle.dumps({"v_template": attack}, protocol=protocol))  # noqa: TID251
    with pytest.raises(ModelError, match=r"attack\.pkl"):
        read_pickle(path)
    assert not Path("PWNED").exists()


@pytest.mark.parametrize(
    "stream",
    [
        b"cos\nsystem\n(S'touch PWNED'\ntR.",
        b"(S'touch PWNED'\nios\nsystem\n.",
        b"(cos\nsystem\nS'touch PWNED'\no.",
        b"cnumpy\ndtype\n(S'f8'\ntR}S'x'\nS'y'\nsb.",
        b"\x80\x02cbuiltins\ngetattr\n.",
        b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7f.",
        b"\x82\x01.",
        b"Pid\n.",
        b"(l" * 3000 + b".",
        b"\x80\x02]q\x00(" + b"h\x00" * 300_000 + b"e.",
        b"",
        b"not a pickle at all",
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\n.",
    ],
)
def test_edge_hand_written_streams(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stream: bytes
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "attack.pkl"
    path.write_bytes(stream)
    with pytest.raises(ModelError, match=r"attack\.pkl"):
        read_pickle(path)
    assert not Path("PWNED").exists()


def test_edge_array_that_lies_about_its_size(tmp_path: Path) -> None:
    path = tmp_path / "lie.pkl"
    state = b"(I1\n(I1000000000\nI1000000000\ntcnumpy\ndtype\n(S'f8'\nI0\nI1\ntRI00\nS'x'\nt"
    head = b"(dS'v'\ncnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR"
    path.write_bytes(head + state + b"bs.")
    with pytest.raises(ModelError, match="does not match its bytes"):
        read_pickle(path)
