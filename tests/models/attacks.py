"""A corpus of hostile pickles: calls in every protocol, opcode streams by hand, and bombs."""

from __future__ import annotations

import builtins
import codecs
import functools
import importlib
import operator
import os
import pickle
import struct
import subprocess
from typing import Any

import numpy as np


class Calls:
    """Pickles into a call of any function."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.function, self.arguments = function, arguments

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return self.function, self.arguments


class States:
    """Pickles into a call whose result is given a state."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (np.dtype, ("f8",), ({}, {"__class__": print}))


CALLS = {
    "system": Calls(os.system, "touch PWNED"),
    "eval": Calls(eval, "open('PWNED', 'w')"),
    "exec": Calls(exec, "open('PWNED', 'w')"),
    "open": Calls(open, "PWNED", "w"),
    "getattr": Calls(getattr, "text", "join"),
    "import": Calls(__import__, "os"),
    "popen": Calls(subprocess.Popen, ["touch", "PWNED"]),
    "import_module": Calls(importlib.import_module, "os"),
    "partial": Calls(functools.partial, print, "x"),
    "attrgetter": Calls(operator.attrgetter, "system"),
    "lookup": Calls(codecs.lookup, "utf-8"),
    "numpy.load": Calls(np.load, "PWNED"),
    "numpy.zeros": Calls(np.zeros, 10**9),
    "bytearray": Calls(bytearray, 10**9),
    "range": Calls(range, 10**9),
    "globals": Calls(builtins.globals),
    "encode": Calls(codecs.encode, "x", "rot13"),
    "state": States(),
}


def called(name: str, protocol: int) -> bytes:
    return pickle.dumps({"v_template": CALLS[name]}, protocol=protocol)  # noqa: TID251


_REBUILD = b"ccopy_reg\n_reconstructor\n("
_CH = b"cchumpy.ch\nCh\n)\x81"
_ARRAY = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tU\x01btR"
_F8 = b"cnumpy\ndtype\n(U\x02f8K\x00K\x01tR"
_O8 = b"cnumpy\ndtype\n(U\x02O8tR"
_U4 = b"cnumpy\ndtype\n(U\x02u4K\x00K\x01tR"


def array(shape: bytes, data: bytes, dtype: bytes = _F8) -> bytes:
    return _ARRAY + b"(K\x01(" + shape + b"t" + dtype + b"I00\n" + data + b"tb"


STREAMS = {
    "global": b"cos\nsystem\n(S'touch PWNED'\ntR.",
    "inst": b"(S'touch PWNED'\nios\nsystem\n.",
    "obj": b"(cos\nsystem\nS'touch PWNED'\no.",
    "setattr by build": b"cnumpy\ndtype\n(S'f8'\ntR}S'x'\nS'y'\nsb.",
    "build of a class": b"\x80\x02cchumpy.ch\nCh\n}b.",
    "build of a dict": b"\x80\x02}}b.",
    "build twice": b"\x80\x02" + _CH + b"}b}b.",
    "slot state that is no dict": b"\x80\x02" + _CH + b"K\x01K\x02\x86b.",
    "dtype state": b"\x80\x02" + _F8 + b"K\x01b.",
    "newobj with arguments": b"\x80\x02cchumpy.ch\nCh\nK\x01\x85\x81.",
    "newobj of ndarray": b"\x80\x02cnumpy\nndarray\n)\x81.",
    "newobj of dict": b"\x80\x02cbuiltins\ndict\n)\x81.",
    "call of a class": b"\x80\x02cchumpy.ch\nCh\n)R.",
    "call of text": b"\x80\x02U\x02os)R.",
    "reconstruct of a list": _REBUILD + b"c__builtin__\nlist\nc__builtin__\nobject\nNtR.",
    "reconstruct from int": _REBUILD + b"cchumpy.ch\nCh\nc__builtin__\nint\nI7\ntR.",
    "getattr": b"\x80\x02cbuiltins\ngetattr\n.",
    "dotted": b"\x80\x04\x8c\x05numpy\x8c\x10core.os.system.x\x93.",
    "dotted module": b"\x80\x04\x8c\x0dnumpy.ndarray\x8c\x04dump\x93.",
    "prefix of scipy": b"cscipy.sparse.csc\nos\n.",
    "prefix of chumpy": b"cchumpy.utils\ncol\n.",
    "stack global of long words": b"\x80\x04X\xff\x0f\0\0" + b"\x1b" * 4095 + b"\x8c\x01x\x93.",
    "stack global of numbers": b"\x80\x04K\x01K\x02\x93.",
    "frame that lies": b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7f.",
    "protocol 6": b"\x80\x06}.",
    "extension": b"\x82\x01.",
    "persistent id": b"Pid\n.",
    "binary persistent id": b"K\x01Q.",
    "next buffer": b"\x80\x05\x97.",
    "read only buffer": b"\x80\x05}\x98.",
    "newobj_ex": b"\x80\x04cchumpy.ch\nCh\n)}\x92.",
    "dup": b"}2.",
    "pop": b"}}0.",
    "unknown opcode": b"\xff.",
    "lists in lists": b"(l" * 3000 + b".",
    "deep": b"]" * 50_000 + b"a" * 49_999 + b".",
    "itself": b"\x80\x02]q\x00h\x00a.",
    "itself in a dict": b"\x80\x02}q\x00U\x01ah\x00s.",
    "many opcodes": b"\x80\x02]q\x00(" + b"h\x00" * 300_000 + b"e.",
    "empty": b"",
    "text": b"not a pickle at all",
    "a class for a value": b"\x80\x02cnumpy.core.multiarray\n_reconstruct\n.",
    "class in a dict": b"\x80\x02}U\x01acnumpy\nndarray\ns.",
    "no memo": b"h\x05.",
    "memo index": b"\x80\x02}r\xff\xff\xff\xff.",
    "memo of nothing": b"q\x00.",
    "huge integer": b"\x8b\xff\xff\xff\x7f\x01.",
    "negative length": b"T\xff\xff\xff\xff.",
    "long text integer": b"L" + b"9" * 200_000 + b"L\n.",
    "text integer": b"I" + b"9" * 200_000 + b"\n.",
    "float": b"Fabc\n.",
    "unmatched mark": b"t.",
    "dict without a value": b"(U\x01ad.",
    "number for a key": b"}K\x01K\x02s.",
    "array for a key": b"}" + _ARRAY + b"K\x02s.",
    "set items of a list": b"]U\x01aK\x02s.",
    "append to a dict": b"}K\x01a.",
    "append to nothing": b"K\x01a.",
    "odd quotes": b"S'abc\n.",
    "odd escape": b"S'\\q'\n.",
    "odd unicode": b"V\\u12\n.",
    "odd utf8": b"X\x02\x00\x00\x00\xff\xff.",
    "object dtype": b"}U\x01a" + array(b"K\x01", b"U\x08aaaaaaaa", _O8) + b"s.",
    "void dtype": b"cnumpy\ndtype\n(U\x02V8tR.",
    "record dtype": b"cnumpy\ndtype\n(]tR.",
    "huge dtype": b"cnumpy\ndtype\n(U\x0aS999999999tR.",
    "negative shape": b"}U\x01a" + array(b"J\xff\xff\xff\xff", b"U\x08aaaaaaaa") + b"s.",
    "array without state": b"}U\x01a" + _ARRAY + b"s.",
    "chumpy without state": b"\x80\x02}U\x01a" + _CH + b"s.",
    "array is the file": array(b"K\x01", b"U\x08aaaaaaaa") + b".",
    "encode": b"c_codecs\nencode\n(V\\u20ac\nS'latin1'\ntR.",
    "encode by a codec": b"c_codecs\nencode\n(Vab\nS'zip'\ntR.",
    "set of a number": b"c__builtin__\nset\n(K\x05tR.",
    "order of a dtype": b"\x80\x02" + _F8 + b"(K\x03U\x01?NNNtb.",
}  # fmt: skip


def lying_array() -> bytes:
    """An array that declares 10^18 items over one byte."""
    return b"}U\x01v" + array(b"I1000000000\nI1000000000\n", b"U\x01x") + b"s."


def doubling(levels: int) -> bytes:
    """Lists of two references each: 2 ** levels items once they are followed."""
    body = b"]q\x00"
    for k in range(levels):
        body += b"(" + (b"h" + bytes([k])) * 2 + b"lq" + bytes([k + 1])
    return b"\x80\x02}U\x01a(" + body + b"ls."


def wide(levels: int = 7, width: int = 2000) -> bytes:
    """Few levels of very many references each."""
    body = b"]q\x00"
    for k in range(levels):
        body += b"(" + (b"h" + bytes([k])) * width + b"lq" + bytes([k + 1])
    return b"\x80\x02}U\x01a(" + body + b"ls."


def encoded(times: int = 20_000, size: int = 2**20) -> bytes:
    """One text, encoded again and again."""
    text = b"X" + struct.pack("<I", size) + b"a" * size
    again = b"c_codecs\nencode\n(h\x00U\x06latin1tR"
    return b"\x80\x02" + text + b"q\x00(" + again * times + b"l."


def swapped(times: int = 5_000, size: int = 2**20) -> bytes:
    """Arrays of foreign byte order that share their data: each is a copy."""
    data = b"T" + struct.pack("<i", size) + b"\0" * size + b"q\x00"
    one = array(b"J" + struct.pack("<i", size // 8), b"h\x00", b"cnumpy\ndtype\n(U\x03>f8tR")
    return b"\x80\x02}U\x01x" + data + b"sU\x01a(" + one * times + b"ls."


def sparse(side: int = 10**6) -> bytes:
    """A scipy matrix of 10^12 zeros."""
    number = b"J" + struct.pack("<i", side)
    state = b"(U\x06_shape" + number * 2 + b"\x86U\x04dataU\x01xd"
    return b"\x80\x02}U\x01acscipy.sparse.csc\ncsc_matrix\n)\x81" + state + b"bs."


def selected(times: int = 2_000, size: int = 2**17) -> bytes:
    """Chumpy selections that share one long list of picks."""
    picks = array(b"J" + struct.pack("<i", size),
                  b"T" + struct.pack("<i", 4 * size) + b"\0" * 4 * size, _U4)  # fmt: skip
    source = array(b"K\x01", b"U\x08aaaaaaaa")
    one = (b"cchumpy.reordering\nSelect\n)\x81(U\x01ah\x02U\x04idxsh\x01U\x0fpreferred_shapeJ"
           + struct.pack("<i", size) + b"\x85db")  # fmt: skip
    return (
        b"\x80\x02}U\x01x"
        + picks
        + b"q\x01sU\x01y"
        + source
        + b"q\x02sU\x01a("
        + one * times
        + b"ls."
    )


def outside() -> bytes:
    """A sparse matrix with an entry outside its shape."""
    ids = array(b"K\x01", b"U\x04\xff\0\0\0", _U4)
    ends = array(b"K\x02", b"U\x08\0\0\0\0\1\0\0\0", _U4)
    value = array(b"K\x01", b"U\x08\0\0\0\0\0\0\0\0")
    state = b"(U\x06_shapeK\x02K\x01\x86U\x04data" + value + b"U\x07indices" + ids
    state += b"U\x06indptr" + ends + b"d"
    return b"\x80\x02}U\x01acscipy.sparse.csc\ncsc_matrix\n)\x81" + state + b"bs."


def wide_text(size: int = 50 * 2**20) -> bytes:
    """A long text with one character that makes all of them four bytes wide."""
    raw = b"a" * size + "\U0001f600".encode()
    return b"\x80\x02X" + struct.pack("<I", len(raw)) + raw + b"."


def wide_line(size: int = 50 * 2**20) -> bytes:
    return b"V" + b"a" * size + b"\\U0001f600\n."


def shared_bytes(times: int = 1000, size: int = 2**20) -> bytes:
    """A byte string that a list holds again and again."""
    data = b"T" + struct.pack("<i", size) + b"\0" * size + b"q\x00"
    return b"\x80\x02}U\x01x" + data + b"sU\x01a(" + b"h\x00" * times + b"ls."


def shared_text(times: int = 1000, size: int = 2**20) -> bytes:
    """Arrays that share one text for their data."""
    data = b"X" + struct.pack("<I", size) + b"a" * size + b"q\x00"
    one = array(b"J" + struct.pack("<i", size // 8), b"h\x00")
    return b"\x80\x02}U\x01x" + data + b"sU\x01a(" + one * times + b"ls."


def nested_in_chumpy(item: bytes = b"K\x01", times: int = 100, width: int = 90) -> bytes:
    """Chumpy objects whose value is one nested list of 730 thousand items."""
    lists = b"("
    for k in range(3):
        lists += b"(" + (b"h" + bytes([k])) * width + b"lq" + bytes([k + 1])
    one = b"cchumpy.ch\nCh\n)\x81(U\x01xh\x03db"
    return b"\x80\x02}U\x01i" + item + b"q\x00sU\x01b" + lists + b"lsU\x01a(" + one * times + b"ls."


def reshaped(times: int = 1000, size: int = 2**17) -> bytes:
    """Chumpy objects that give one array of Fortran's order another shape: each is a copy."""
    shape = b"J" + struct.pack("<i", size // 2) + b"K\x02t"
    data = b"T" + struct.pack("<i", 8 * size) + b"\0" * (8 * size)
    source = _ARRAY + b"(K\x01(" + shape + _F8 + b"I01\n" + data + b"tbq\x00"
    one = b"cchumpy.reordering\nReshape\n)\x81(U\x01ah\x00U\x08newshape(J"
    one += struct.pack("<i", size) + b"tdb"
    return b"\x80\x02}U\x01x" + source + b"sU\x01a(" + one * times + b"ls."


def wrapping_pointers() -> bytes:
    """A sparse matrix whose pointers rise by 2^63 - 1 once differences of 64 bits wrap."""
    ends = np.array([0, 2**63 - 1, -(2**63), -1, 1], dtype="<i8")
    dtype = b"cnumpy\ndtype\n(U\x02i8K\x00K\x01tR"
    pointers = array(b"K\x05", b"U\x28" + ends.tobytes(), dtype)
    one = array(b"K\x01", b"U\x08" + bytes(8))
    index = array(b"K\x01", b"U\x04" + bytes(4), _U4)
    state = b"(U\x06_shapeK\x01K\x04\x86U\x04data" + one + b"U\x07indices" + index
    state += b"U\x06indptr" + pointers + b"d"
    return b"\x80\x02}U\x01acscipy.sparse.csc\ncsc_matrix\n)\x81" + state + b"bs."


BOMBS = {
    "lying array": lying_array, "doubling": lambda: doubling(40), "wide": wide,
    "encoded": encoded, "swapped": swapped, "sparse": sparse, "selected": selected,
    "outside": outside, "wide text": wide_text, "wide line": wide_line,
    "shared bytes": shared_bytes, "shared text": shared_text, "reshaped": reshaped,
    "nested in chumpy": nested_in_chumpy,
    "texts in chumpy": lambda: nested_in_chumpy(b"U\xff" + b"a" * 255, times=1),
    "wrapping pointers": wrapping_pointers,
}  # fmt: skip
