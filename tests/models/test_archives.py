"""Archives and arrays that lie about their size, are damaged, or hide a pickle."""

from __future__ import annotations

import contextlib
import io
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import attacks
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_pickles import bounded

from synthgen.errors import ModelError
from synthgen.models.archives import npy_value, read_npz
from synthgen.models.content import read_content


def header(text: str, version: int = 1) -> bytes:
    raw = text.encode()
    size = struct.pack("<H" if version == 1 else "<I", len(raw))
    return b"\x93NUMPY" + bytes([version, 0]) + size + raw


def described(shape: str, descr: str = "'<f8'") -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n"


HEADERS = {
    "gigantic": header(described("(1000000000000,)")),
    "gigantic product": header(described("(1000000, 1000000, 1000000)")),
    "beyond 64 bits": header(described("(281474976710655, 281474976710655)")),
    "too small": header(described("(2,)")) + b"\0" * 8,
    "too long": header(described("(1,)")) + b"\0" * 800,
    "negative": header(described("(-1,)")) + b"\0" * 8,
    "bool": header(described("(True,)")) + b"\0" * 8,
    "float": header(described("(1.0,)")) + b"\0" * 8,
    "list": header(described("[1]")) + b"\0" * 8,
    "many dimensions": header(described("(" + "1," * 40 + ")")) + b"\0" * 8,
    "record": header(described("(1,)", "[('a', '<f8')]")) + b"\0" * 8,
    "nested record": header(described("(1,)", "[('a', '<f8', (10**9,))]")) + b"\0" * 8,
    "counted": header(described("(1,)", "'3f8'")) + b"\0" * 24,
    "two in one": header(described("(1,)", "'f2,f2'")) + b"\0" * 4,
    "void": header(described("(1,)", "'|V8'")) + b"\0" * 8,
    "date": header(described("(1,)", "'<M8[s]'")) + b"\0" * 8,
    "huge item": header(described("(1,)", "'S999999999'")) + b"\0" * 8,
    "code": header("__import__('os').system('touch PWNED')\n"),
    "parentheses": header("(" * 3000 + ")" * 3000 + "\n"),
    "long header": header("x" * 60000),
    "header that lies": b"\x93NUMPY\x02\x00\xff\xff\xff\xff{}",
    "missing key": header("{'descr': '<f8', 'shape': (1,)}\n") + b"\0" * 8,
    "extra key": header("{'descr': '<f8', 'shape': (1,), 'fortran_order': False, 'x': 1}\n"),
    "version 9": b"\x93NUMPY\x09\x00" + b"\0" * 20,
    "not numpy": b"PK\x03\x04" + b"\0" * 30,
    "empty": b"",
    "binary": header("\x00\x01\x02"),
    "empty with huge shape": header(described("(0, 281474976710655, 281474976710655)")),
}  # fmt: skip


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refuse(path: Path, words: str = "") -> None:
    with bounded(), pytest.raises(ModelError, match=path.name) as caught:
        read_content(path)
    assert words in str(caught.value)
    assert not Path("PWNED").exists()


def zipped(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def saved(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize("name", HEADERS)
def test_edge_headers(name: str, tmp_path: Path) -> None:
    (tmp_path / "bad.npy").write_bytes(HEADERS[name])
    refuse(tmp_path / "bad.npy")
    refuse(zipped(tmp_path / "bad.npz", {"v_template.npy": HEADERS[name]}), "v_template")


@pytest.mark.parametrize("value", [
    np.arange(6.0).reshape(2, 3), np.asfortranarray(np.arange(6).reshape(2, 3)), np.array("lbs"),
    np.arange(3, dtype=">f4"), np.zeros((0, 3)), np.array(2.5), np.array(["a", "bc"]),
    np.array([True, False]), np.array(b"xy"),
])  # fmt: skip
def test_reference_what_numpy_writes(value: Any) -> None:
    found = npy_value(saved(value))
    np.testing.assert_array_equal(found, value)
    assert found.dtype == value.dtype.newbyteorder("=")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_reference_archives(save: Any, tmp_path: Path) -> None:
    inner = {"left": np.arange(4), "names": ["a", "b"]}
    save(tmp_path / "a.npz", x=np.arange(3.0), o=np.array(inner, dtype=object))
    found = read_npz(tmp_path / "a.npz")
    np.testing.assert_array_equal(found["x"], np.arange(3.0))
    np.testing.assert_array_equal(found["o"]["left"], np.arange(4))
    assert found["o"]["names"] == ["a", "b"]


@pytest.mark.parametrize("protocol", [2, 4])
@pytest.mark.parametrize("name", attacks.CALLS)
def test_edge_a_pickle_in_an_object_member(name: str, protocol: int, tmp_path: Path) -> None:
    hostile = header(described("()", "'|O'")) + attacks.called(name, protocol)
    (tmp_path / "bad.npy").write_bytes(hostile)
    refuse(tmp_path / "bad.npy")
    refuse(zipped(tmp_path / "bad.npz", {"v_template.npy": hostile}), "v_template")


def test_edge_zip_bomb(tmp_path: Path) -> None:
    zeros = header(described("(36700160,)")) + bytes(8 * 36700160)
    path = zipped(tmp_path / "bomb.npz", {"v_template.npy": zeros})
    assert path.stat().st_size < 400_000
    refuse(path, "may unpack to")


def test_edge_many_small_bombs(tmp_path: Path) -> None:
    zeros = header(described("(131072,)")) + bytes(8 * 131072)
    members = {f"m{k}.npy": zeros for k in range(300)}
    refuse(zipped(tmp_path / "bomb.npz", members), "may unpack to")


def test_edge_size_in_the_directory_that_lies(tmp_path: Path) -> None:
    """A member that says it is small: no more than that is unpacked."""
    zeros = header(described("(12500000,)")) + bytes(100_000_000)
    path = zipped(tmp_path / "bomb.npz", {"v.npy": zeros})
    data, size = path.read_bytes(), struct.pack("<I", len(zeros))
    assert data.count(size) >= 2
    path.write_bytes(data.replace(size, struct.pack("<I", 1000)))
    refuse(path)


def test_edge_many_members(tmp_path: Path) -> None:
    path = zipped(tmp_path / "many.npz", {f"m{k}": b"" for k in range(60_000)}, 0)
    refuse(path, "60000 members")


def test_edge_duplicate_and_odd_members(tmp_path: Path) -> None:
    one = saved(np.zeros(3))
    with pytest.warns(UserWarning, match="Duplicate"):
        with zipfile.ZipFile(tmp_path / "twice.npz", "w") as archive:
            archive.writestr("v.npy", one)
            archive.writestr("v.npy", one)
    refuse(tmp_path / "twice.npz", "two members")
    refuse(zipped(tmp_path / "same.npz", {"v.npy": one, "v": one}), "two members of one name, 'v'")
    refuse(zipped(tmp_path / "lzma.npz", {"v.npy": one}, zipfile.ZIP_LZMA), "compressed")
    encrypted = bytearray(zipped(tmp_path / "locked.npz", {"v.npy": one}).read_bytes())
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        encrypted[encrypted.index(mark) + at] |= 1
    (tmp_path / "locked.npz").write_bytes(encrypted)
    refuse(tmp_path / "locked.npz", "encrypted")


def test_edge_truncated(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "whole.npz", v=np.arange(500.0))
    data = (tmp_path / "whole.npz").read_bytes()
    for end in range(0, len(data), 7):
        (tmp_path / "cut.npz").write_bytes(data[:end])
        with pytest.raises(ModelError, match=r"cut\.npz"):
            read_npz(tmp_path / "cut.npz")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_edge_flipped_bits(save: Any, tmp_path: Path) -> None:
    """A checksum guards the content of archives: what is read at all is what was written."""
    save(tmp_path / "whole.npz", v=np.arange(40.0))
    data = bytearray((tmp_path / "whole.npz").read_bytes())
    for at in range(len(data)):
        data[at] ^= 1 << (at % 8)
        (tmp_path / "flip.npz").write_bytes(data)
        with contextlib.suppress(ModelError):
            found = read_npz(tmp_path / "flip.npz")
            for value in found.values():
                np.testing.assert_array_equal(value, np.arange(40.0))
        data[at] ^= 1 << (at % 8)


def test_edge_not_there_and_no_dict(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"not a readable|cannot be read"):
        read_npz(tmp_path / "none.npz")
    np.save(tmp_path / "one.npy", np.zeros(3))
    with pytest.raises(ModelError, match="a model is a dict of arrays"):
        read_content(tmp_path / "one.npy")


def fuzz(data: bytes, folder: Path) -> None:
    path = folder / "fuzz.npz"
    path.write_bytes(data)
    with contextlib.suppress(ModelError):
        read_npz(path)
    with contextlib.suppress(ModelError):
        npy_value(data)


def rebuilt(name: str, text: str, body: bytes) -> bytes:
    raw = header(text) + body
    head = struct.pack("<4s5H3I2H", b"PK\x03\x04", 20, 0, 0, 0, 0, zlib.crc32(raw), len(raw),
                       len(raw), len(name), 0) + name.encode()  # fmt: skip
    entry = struct.pack("<4s6H3I5H2I", b"PK\x01\x02", 20, 20, 0, 0, 0, 0, zlib.crc32(raw),
                        len(raw), len(raw), len(name), 0, 0, 0, 0, 0, 0)  # fmt: skip
    entry += name.encode()
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 1, 1, len(entry), len(head) + len(raw), 0)
    return head + raw + entry + end


TEXTS = st.one_of(
    st.text(max_size=80),
    st.builds(
        described,
        st.one_of(st.text(max_size=20), st.sampled_from(["(1,)", "()", "(0,)", "(2**70,)"])),
        st.one_of(st.text(max_size=8), st.sampled_from(["'<f8'", "'|O'", "'<U3'", "'S0'"])),
    ),
)


def test_smoke_the_fuzzed_form_is_read(tmp_path: Path) -> None:
    path = tmp_path / "built.npz"
    path.write_bytes(rebuilt("v.npy", described("(1,)"), struct.pack("<d", 2.5)))
    assert read_npz(path)["v"] == [2.5]


@pytest.mark.prove
@settings(max_examples=20_000, deadline=None)
@given(
    TEXTS,
    st.one_of(
        st.binary(max_size=64),
        st.sampled_from([s for s in attacks.STREAMS.values() if len(s) < 300]),
    ),
)
def test_prove_fuzz_of_headers(text: str, body: bytes) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        fuzz(rebuilt("v.npy", text, body), Path(folder))


@pytest.mark.prove
@settings(max_examples=20_000, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5000), st.binary(max_size=5)), min_size=1, max_size=6))
def test_prove_fuzz_of_archives(changes: list[tuple[int, bytes]]) -> None:
    import tempfile

    stream = io.BytesIO()
    np.savez_compressed(stream, v=np.arange(9.0), o=np.array({"a": np.arange(3)}, dtype=object))
    data = stream.getvalue()
    for at, piece in changes:
        at %= len(data)
        data = data[:at] + piece + data[at + len(piece) :]
    with tempfile.TemporaryDirectory() as folder:
        fuzz(data, Path(folder))
