"""Attacks: nothing in a file is ever executed; each ends in one clear error, soon and small."""

from __future__ import annotations

import contextlib
import pickle
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attacks
import body_files
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from synthgen.errors import ModelError
from synthgen.models.content import read_content
from synthgen.models.pickles import unpickled, unpickled_dict

LIMIT_BYTES = 350 * 2**20


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Fail where more than 350 MB beyond the interpreter's own are taken.

    Time is a promise of its own, below: tracing memory multiplies it.
    """
    tracemalloc.start()
    try:
        yield
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < LIMIT_BYTES


def refuse(data: bytes, folder: Path) -> str:
    path = folder / "attack.pkl"
    path.write_bytes(data)
    with bounded(), pytest.raises(ModelError, match=r"attack\.pkl") as caught:
        read_content(path)
    assert not Path("PWNED").exists()
    return str(caught.value)


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("name", attacks.CALLS)
def test_edge_calls(name: str, protocol: int, tmp_path: Path) -> None:
    words = refuse(attacks.called(name, protocol), tmp_path)
    assert any(w in words for w in ("which no model file needs", "encodes text", "state"))


@pytest.mark.parametrize("name", attacks.STREAMS)
def test_edge_hand_written_streams(name: str, tmp_path: Path) -> None:
    assert len(refuse(attacks.STREAMS[name], tmp_path)) < 600


@pytest.mark.parametrize("name", attacks.BOMBS)
def test_edge_bombs(name: str, tmp_path: Path) -> None:
    refuse(attacks.BOMBS[name](), tmp_path)


@pytest.mark.prove
def test_prove_each_attack_ends_within_a_second(tmp_path: Path) -> None:
    path = tmp_path / "attack.pkl"
    streams = {**attacks.STREAMS, **{name: make() for name, make in attacks.BOMBS.items()}}
    for name, data in streams.items():
        path.write_bytes(data)
        start = time.process_time()
        with pytest.raises(ModelError):
            read_content(path)
        assert time.process_time() - start < 1.0, name


def test_edge_words_name_what_was_refused(tmp_path: Path) -> None:
    assert "os.system" in refuse(attacks.STREAMS["global"], tmp_path)
    assert "INST" in refuse(attacks.STREAMS["inst"], tmp_path)
    assert "does not match its bytes" in refuse(attacks.lying_array(), tmp_path)
    assert "nested deeper" in refuse(attacks.doubling(25), tmp_path)


def test_edge_too_large(tmp_path: Path) -> None:
    path = tmp_path / "huge.pkl"
    with path.open("wb") as stream:
        stream.truncate(10 * 2**30)  # sparse: takes no disk
    with bounded(), pytest.raises(ModelError, match="at most"):
        read_content(path)


def valid() -> dict[str, Any]:
    return {
        "a": np.arange(12.0).reshape(3, 4),
        "b": np.asfortranarray(np.arange(6, dtype=np.int32).reshape(2, 3)),
        "c": np.arange(3, dtype=">f8"),
        "d": np.float64(2.5),
        "e": [1, 2.5, "text", None, True],
        "f": (1, 2),
        "g": {"inner": np.zeros((0, 3))},
        "h": "words",
        "i": b"bytes",
        "j": -(2**40),
        "k": np.array(["lbs"]),
        "m": np.float32(1.5),
        "n": np.arange(4) > 1,
    }


def same(found: Any, wanted: Any) -> None:
    if isinstance(wanted, dict):
        assert found.keys() == wanted.keys()
        for key in wanted:
            same(found[key], wanted[key])
    elif isinstance(wanted, np.ndarray | np.generic):
        np.testing.assert_array_equal(found, wanted)
        assert np.asarray(found).dtype == wanted.dtype.newbyteorder("=")
    elif isinstance(wanted, tuple):
        assert list(wanted) == found
    elif isinstance(wanted, bytes):
        assert found in (wanted, wanted.decode("latin1"))
    else:
        assert found == wanted


@pytest.mark.parametrize("protocol", range(6))
def test_reference_values_of_python_3(protocol: int) -> None:
    found = unpickled_dict(pickle.dumps(valid(), protocol=protocol))  # noqa: TID251
    same(found, valid())


@pytest.mark.parametrize("protocol", range(3))
def test_reference_values_of_python_2(protocol: int) -> None:
    values = {k: v for k, v in valid().items() if k not in "dmk"}
    values["j"] = 7
    same(unpickled_dict(body_files.Python2(protocol).dumps(values)), values)


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("form", ["csc_matrix", "csr_matrix", "coo_matrix", "csc_array"])
def test_reference_scipy_of_today(form: str, protocol: int) -> None:
    dense = np.zeros((4, 7))
    dense[[0, 3, 2], [6, 1, 1]] = [1.5, 2.5, -3]
    data = pickle.dumps({"m": getattr(sparse, form)(dense)}, protocol=protocol)  # noqa: TID251
    np.testing.assert_array_equal(unpickled_dict(data)["m"], dense)


def test_reference_entries_given_twice_are_summed() -> None:
    matrix = sparse.coo_matrix(([1.0, 2.0, 4.0], ([0, 0, 1], [1, 1, 0])), shape=(2, 2))
    data = pickle.dumps({"m": matrix}, protocol=2)  # noqa: TID251
    np.testing.assert_array_equal(unpickled_dict(data)["m"], [[0, 3], [4, 0]])


def test_reference_module_names_of_numpy_1_and_2() -> None:
    values = {"a": np.arange(5.0), "b": np.float64(3)}
    new = pickle.dumps(values, protocol=2)  # noqa: TID251
    old = new.replace(b"numpy._core.multiarray", b"numpy.core.multiarray")
    assert old != new
    for data in (old, new):
        same(unpickled_dict(data), values)


@pytest.mark.parametrize("kind", ["pickle", "python2"])
def test_edge_truncated_anywhere(kind: str) -> None:
    values = {k: v for k, v in valid().items() if k not in "djmk"}
    data = (
        pickle.dumps(values, protocol=4)  # noqa: TID251
        if kind == "pickle"
        else body_files.Python2(0).dumps(values)
    )
    for end in range(len(data)):
        with pytest.raises(ModelError):
            unpickled(data[:end])


@pytest.mark.parametrize("protocol", range(6))
def test_edge_flipped_bits_raise_nothing_else(protocol: int) -> None:
    data = bytearray(pickle.dumps(valid(), protocol=protocol))  # noqa: TID251
    for at in range(len(data)):
        for bit in (at % 3, 3 + at % 5):
            data[at] ^= 1 << bit
            with contextlib.suppress(ModelError):
                unpickled(bytes(data))
            data[at] ^= 1 << bit


OPCODES = st.lists(
    st.one_of(
        st.sampled_from([bytes([b]) for b in range(256)]),
        st.sampled_from(
            [*(s for s in attacks.STREAMS.values() if len(s) < 300), b"cnumpy\ndtype\n",
             b"cnumpy\nndarray\n", b"U\x02f8", b")",
             b"cnumpy.core.multiarray\n_reconstruct\n", b"cnumpy.core.multiarray\nscalar\n", b"(",
             b"cnumpy._core.numeric\n_frombuffer\n", b"ccopy_reg\n__newobj__\n", b"\x81", b"R",
             b"ccollections\nOrderedDict\n", b"b", b"t", b"d", b"l", b"s", b"u", b"a", b"e",
             attacks.array(b"K\x01", b"U\x08aaaaaaaa"), b"\x85", b"\x86", b"\x87", b"K\x02"]
        ),
        st.binary(max_size=12),
    ),
    max_size=40,
)  # fmt: skip


def fuzz(parts: list[bytes]) -> None:
    with contextlib.suppress(ModelError):
        unpickled(b"".join(parts) + b".")


@settings(max_examples=300, deadline=None, derandomize=True)
@given(OPCODES)
def test_properties_fuzz(parts: list[bytes]) -> None:
    fuzz(parts)


@pytest.mark.prove
@settings(max_examples=5_000, deadline=None)
@given(OPCODES)
def test_prove_fuzz_of_opcodes(parts: list[bytes]) -> None:
    fuzz(parts)


@pytest.mark.prove
@settings(max_examples=20_000, deadline=None)
@given(st.integers(0, 5), st.lists(st.tuples(st.integers(0, 4000), st.binary(max_size=6)),
                                   min_size=1, max_size=5))  # fmt: skip
def test_prove_fuzz_of_mutations(protocol: int, changes: list[tuple[int, bytes]]) -> None:
    data = pickle.dumps(valid(), protocol=protocol)  # noqa: TID251
    for at, piece in changes:
        at %= len(data)
        data = data[:at] + piece + data[at + len(piece) // 2 :]
    with contextlib.suppress(ModelError):
        unpickled(data)
