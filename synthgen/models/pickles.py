"""Read the pickles of published models without executing anything in them.

A stack machine of our own: only the opcodes of its table exist, globals are inert tokens, and
every copy that a file asks for is paid from a budget. Nothing of :mod:`pickle` is used.
"""

from __future__ import annotations

import codecs
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from synthgen.errors import ModelError
from synthgen.models import holders
from synthgen.models.holders import Holder
from synthgen.models.holdings import Budget, plain

MAX_BYTES = 300 * 2**20
MAX_OPCODES = 200_000
# Shorter byte strings become text; longer ones are array data and stay slices of the file.
_TEXT_BYTES = 4096
# First byte of the UTF-8 of characters that latin1 lacks: array data has none of them.
_BEYOND_LATIN1 = 0xC4
# A backslash that starts none of the escapes of a Python 2 string.
_ODD_ESCAPE = re.compile(rb"\\(?![nrtabfv'\"]|x[0-9a-fA-F]{2}|[0-3][0-7]{2}|[0-7]{1,2}(?![0-7]))")


def read_bytes(path: Path) -> bytes:
    """Read a whole regular file of bounded size.

    Raises
    ------
    ModelError
        If it is larger than any model, or cannot be read.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise ModelError(f"{size} bytes; a model file has at most {MAX_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise ModelError(f"cannot be read ({error.strerror})") from None


def starts_well(head: bytes) -> bool:
    """Tell whether a pickle that is read could start so; a file of nothing ends too soon."""
    return not head or head[0] in _STEPS or head[:1] == b"."


def unpickled_dict(data: bytes, start: int = 0) -> dict[str, Any]:
    """Read a pickled dict that starts at ``start``; holders become arrays.

    Raises
    ------
    ModelError
        If the pickle is damaged, hostile, or holds something else.
    """
    loaded = unpickled(data, start)
    if not isinstance(loaded, dict):
        raise ModelError(f"holds a {type(loaded).__name__}; a model pickle holds a dict")
    return loaded


def unpickled(data: bytes, start: int = 0) -> Any:
    """Read one pickled value; see :func:`unpickled_dict`."""
    budget = Budget(min(2 * len(data) + 2**24, MAX_BYTES))
    try:
        return plain(_Machine(data, start, budget).run(), budget)
    except ModelError:
        raise
    except (RecursionError, MemoryError, OverflowError) as error:
        raise ModelError(f"not a model pickle ({type(error).__name__})") from None
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, struct.error) as error:
        raise ModelError(f"truncated or damaged pickle ({error})") from None


class _Machine:
    """Opcodes to values. Values are numbers, text, bytes, containers, tokens and holders."""

    def __init__(self, data: bytes, start: int, budget: Budget) -> None:
        self.data, self.at, self.budget = data, start, budget
        self.view = memoryview(data)
        self.stack: list[Any] = []
        self.marks: list[list[Any]] = []
        self.memo: dict[int, Any] = {}

    def run(self) -> Any:
        for _ in range(MAX_OPCODES):
            code = self.take(1)[0]
            step = _STEPS.get(code)
            if step is None:
                if code == ord("."):
                    return self.stack.pop()
                name = _REFUSED.get(code, f"{code:#04x}")
                raise ModelError(f"pickle opcode {name} is refused; no model file needs it")
            step(self)
        raise ModelError(f"more than {MAX_OPCODES} pickle opcodes; no model file needs them")

    # Reading arguments.

    def take(self, n: int) -> memoryview:
        end = self.at + n
        if n < 0 or end > len(self.data):
            raise ModelError(f"truncated or damaged pickle ({n} bytes wanted at byte {self.at})")
        self.at, piece = end, self.view[self.at : end]
        return piece

    def number(self, form: str) -> Any:
        return struct.unpack(form, self.take(struct.calcsize(form)))[0]

    def line(self) -> bytes:
        end = self.data.find(b"\n", self.at)
        if end < 0:
            raise ModelError("truncated or damaged pickle (a line has no end)")
        line = self.data[self.at : end]
        self.budget.spend(len(line), "a line of text")
        self.at = end + 1
        return line

    # Stack and memo.

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def since_mark(self) -> list[Any]:
        items, self.stack = self.stack, self.marks.pop()
        return items

    def put(self, index: int) -> None:
        if not 0 <= index <= MAX_OPCODES:
            raise ModelError(f"pickle memo entry {index}; no model file has so many")
        self.memo[index] = self.stack[-1]

    def get(self, index: int) -> None:
        if index not in self.memo:
            raise ModelError(f"truncated or damaged pickle (no memo entry {index})")
        self.push(self.memo[index])

    # Text and bytes.

    def byte_string(self, n: int) -> None:
        """Push a byte string: short ones of Python 2 are text, long ones array data."""
        raw = self.take(n)
        self.push(raw if n > _TEXT_BYTES else str(raw, "latin1"))

    def utf8(self, n: int) -> None:
        raw = self.take(n)
        self.budget.spend(n, "text")
        if n > _TEXT_BYTES and np.frombuffer(raw, np.uint8).max() >= _BEYOND_LATIN1:
            raise ModelError(f"text of {n} bytes that is no array data")
        self.push(str(raw, "utf-8", "surrogatepass"))

    def quoted(self) -> None:
        line = self.line().strip()
        if len(line) < 2 or line[:1] not in (b"'", b'"') or line[-1:] != line[:1]:
            raise ModelError("truncated or damaged pickle (a string without its quotes)")
        if _ODD_ESCAPE.search(line.replace(rb"\\", b"__")):
            raise ModelError("truncated or damaged pickle (an unknown escape in a string)")
        raw, _ = codecs.escape_decode(line[1:-1])
        self.push(memoryview(raw) if len(raw) > _TEXT_BYTES else raw.decode("latin1"))

    def raw_unicode(self) -> None:
        line = self.line()
        self.budget.spend(3 * len(line), "text")  # a wide character widens all of them
        self.push(line.decode("raw-unicode-escape"))

    # Numbers as text.

    def text_int(self) -> None:
        line = self.line()
        self.push({b"00": False, b"01": True}[line] if line in (b"00", b"01") else _decimal(line))

    # Containers.

    def into_list(self, items: list[Any]) -> None:
        target = self.stack[-1]
        if not isinstance(target, list):
            raise ModelError(f"the file appends to a {type(target).__name__}, not a list")
        target.extend(items)

    def into_dict(self, items: list[Any]) -> None:
        target = self.stack[-1]
        if not isinstance(target, dict) or len(items) % 2:
            raise ModelError(f"the file sets items of a {type(target).__name__}, not a dict")
        target.update(_pairs(items))

    def tuple_of(self, n: int) -> None:
        if len(self.stack) < n:
            raise ModelError("truncated or damaged pickle (stack is empty)")
        items = tuple(self.stack[len(self.stack) - n :])
        del self.stack[len(self.stack) - n :]
        self.push(items)

    # Objects.

    def global_lines(self) -> None:
        module, name = (self.line().decode("ascii", "replace")[:100] for _ in range(2))
        self.push(holders.find(module, name))

    def stack_global(self) -> None:
        name, module = self.stack.pop(), self.stack.pop()
        self.push(holders.find(module, name))

    def reduce(self) -> None:
        arguments, token = self.stack.pop(), self.stack.pop()
        result = holders.call(token, arguments)
        if isinstance(result, bytes):
            self.budget.spend(len(result), "encoded text")
        self.push(result)

    def new_object(self) -> None:
        arguments, token = self.stack.pop(), self.stack.pop()
        if arguments != ():
            raise ModelError("the file creates an object with arguments; no model file does")
        self.push(holders.new(token))

    def build(self) -> None:
        state = self.stack.pop()
        if not isinstance(self.stack[-1], Holder):
            raise ModelError(f"the file sets the state of a {type(self.stack[-1]).__name__}")
        self.stack[-1].build(state)

    def mark(self) -> None:
        self.marks.append(self.stack)
        self.stack = []

    def protocol(self) -> None:
        version = self.number("<B")
        if version > 5:
            raise ModelError(f"pickle protocol {version}; known are 0 to 5")


def _decimal(line: bytes) -> int:
    if len(line) > 40:
        raise ModelError(f"an integer of {len(line)} digits; no model file needs it")
    return int(line.rstrip(b"L"))


def _long(raw: memoryview) -> int:
    if len(raw) > 16:
        raise ModelError(f"an integer of {len(raw)} bytes; no model file needs it")
    return int.from_bytes(raw, "little", signed=True)


def _pairs(items: list[Any]) -> dict[str, Any]:
    if len(items) % 2:
        raise ModelError("truncated or damaged pickle (a key without a value)")
    return {holders.text_key(k): v for k, v in zip(items[::2], items[1::2], strict=True)}


# The allow-list of opcodes; every other one ends the reading.
_NAMED: Final[dict[str, Callable[[_Machine], Any]]] = {
    "(": _Machine.mark,
    "N": lambda m: m.push(None),
    "\x88": lambda m: m.push(True),
    "\x89": lambda m: m.push(False),
    "I": _Machine.text_int,
    "L": lambda m: m.push(_decimal(m.line())),
    "F": lambda m: m.push(float(m.line()[:100])),
    "J": lambda m: m.push(m.number("<i")),
    "K": lambda m: m.push(m.number("<B")),
    "M": lambda m: m.push(m.number("<H")),
    "G": lambda m: m.push(m.number(">d")),
    "\x8a": lambda m: m.push(_long(m.take(m.number("<B")))),
    "\x8b": lambda m: m.push(_long(m.take(m.number("<i")))),
    "S": _Machine.quoted,
    "T": lambda m: m.byte_string(m.number("<i")),
    "U": lambda m: m.byte_string(m.number("<B")),
    "B": lambda m: m.push(m.take(m.number("<I"))),
    "C": lambda m: m.push(bytes(m.take(m.number("<B")))),
    "\x8e": lambda m: m.push(m.take(m.number("<Q"))),
    "\x96": lambda m: m.push(m.take(m.number("<Q"))),
    "V": _Machine.raw_unicode,
    "X": lambda m: m.utf8(m.number("<I")),
    "\x8c": lambda m: m.utf8(m.number("<B")),
    "\x8d": lambda m: m.utf8(m.number("<Q")),
    "]": lambda m: m.push([]),
    "}": lambda m: m.push({}),
    ")": lambda m: m.push(()),
    "\x8f": lambda m: m.push([]),
    "l": lambda m: m.push(m.since_mark()),
    "d": lambda m: m.push(_pairs(m.since_mark())),
    "t": lambda m: m.push(tuple(m.since_mark())),
    "\x91": lambda m: m.push(m.since_mark()),
    "\x85": lambda m: m.tuple_of(1),
    "\x86": lambda m: m.tuple_of(2),
    "\x87": lambda m: m.tuple_of(3),
    "a": lambda m: m.into_list([m.stack.pop()]),
    "e": lambda m: m.into_list(m.since_mark()),
    "\x90": lambda m: m.into_list(m.since_mark()),
    "s": lambda m: m.into_dict([m.stack.pop(-2), m.stack.pop()]),
    "u": lambda m: m.into_dict(m.since_mark()),
    "p": lambda m: m.put(_decimal(m.line())),
    "q": lambda m: m.put(m.number("<B")),
    "r": lambda m: m.put(m.number("<I")),
    "\x94": lambda m: m.put(len(m.memo)),
    "g": lambda m: m.get(_decimal(m.line())),
    "h": lambda m: m.get(m.number("<B")),
    "j": lambda m: m.get(m.number("<I")),
    "c": _Machine.global_lines,
    "\x93": _Machine.stack_global,
    "R": _Machine.reduce,
    "\x81": _Machine.new_object,
    "b": _Machine.build,
    "\x80": _Machine.protocol,
    "\x95": lambda m: m.number("<Q"),
}
_STEPS: Final = {ord(code): step for code, step in _NAMED.items()}
_REFUSED: Final = {
    ord(code): name
    for code, name in {
        "i": "INST", "o": "OBJ", "\x92": "NEWOBJ_EX", "\x82": "EXT1", "\x83": "EXT2",
        "\x84": "EXT4", "P": "PERSID", "Q": "BINPERSID", "\x97": "NEXT_BUFFER",
        "\x98": "READONLY_BUFFER", "0": "POP", "1": "POP_MARK", "2": "DUP",
    }.items()
}  # fmt: skip
