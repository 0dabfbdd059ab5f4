"""What a model pickle may name: an exact table of globals, each an inert token of our own.

No code of numpy, scipy or chumpy is reachable from a file: a global is looked up by its exact
module and name, and what the file gets is a :class:`Token` that cannot be called. What a file
builds with them is a :class:`Holder` that keeps its state and does nothing with it;
``synthgen.models.holdings`` turns holders into arrays.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from synthgen.errors import ModelError

MAX_ITEM_BYTES = 1024
_DTYPE = re.compile(r"[<>|=]?(b1|\?|[iu][1248]|f[248]|[SU]\d{1,4}|O8?)")


@dataclass(frozen=True)
class Token:
    """What a global of the file stands for; ``kind`` says which of our own steps it may start."""

    kind: str


class Holder:
    """Inert stand-in for a foreign object: its kind and its state."""

    __slots__ = ("built", "kind", "state")

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.state: Any = None
        self.built = False

    def build(self, state: Any) -> None:
        """Keep the state; a second one is refused."""
        if self.built:
            raise ModelError(f"a {self.kind} in the file is given a state twice")
        self.state, self.built = self._accepted(state), True

    def _accepted(self, state: Any) -> Any:
        if isinstance(state, tuple) and len(state) == 2:  # slots beside the dict
            state = {**(state[0] or {}), **(state[1] or {})}
        if not isinstance(state, dict):
            found = type(state).__name__
            raise ModelError(f"a {self.kind} in the file has {found} for a state; expected a dict")
        return state


class ArrayHolder(Holder):
    """A numpy array: (version, shape, dtype, fortran, data) or (shape, dtype, fortran, data)."""

    __slots__ = ()

    def _accepted(self, state: Any) -> Any:
        if not isinstance(state, tuple) or len(state) not in (4, 5):
            raise ModelError("an array in the file has no shape, dtype and data")
        return state[-4:]


class DtypeHolder(Holder):
    """A numpy dtype: its code, and the byte order that its state adds."""

    __slots__ = ("code", "order")

    def __init__(self, code: Any) -> None:
        super().__init__("dtype")
        if not isinstance(code, str) or not _DTYPE.fullmatch(code):
            raise ModelError(
                f"array dtype {code!r}; a model file holds numbers (f, i, u, b), text or objects"
            )
        self.order = code[0] if code[0] in "<>" else "<"
        self.code = code.lstrip("<>|=")

    def _accepted(self, state: Any) -> Any:
        if not isinstance(state, tuple) or len(state) < 2 or state[1] not in ("<", ">", "|", "="):
            raise ModelError("a dtype in the file has no byte order")
        self.order = "<" if state[1] in "=|" else state[1]
        return state

    @property
    def holds_objects(self) -> bool:
        """Whether items are objects of the file rather than bytes."""
        return self.code.startswith("O")

    def numpy(self) -> np.dtype[Any]:
        """Return the dtype of the bytes."""
        result = np.dtype(self.order + self.code)
        if result.hasobject or not 0 < result.itemsize <= MAX_ITEM_BYTES:
            raise ModelError(f"array dtype {self.code!r} has no bytes of its own")
        return result


def _table() -> dict[tuple[str, str], Token]:
    table = {
        ("numpy", "ndarray"): Token("ndarray"),
        ("numpy", "dtype"): Token("dtype"),
        ("_codecs", "encode"): Token("encode"),
        ("collections", "OrderedDict"): Token("dict"),
        ("chumpy.ch", "Ch"): Token("chumpy ch"),
    }
    for numpy in ("numpy.core", "numpy._core"):  # numpy 1 and numpy 2
        table[f"{numpy}.multiarray", "_reconstruct"] = Token("reconstruct")
        table[f"{numpy}.multiarray", "scalar"] = Token("scalar")
        table[f"{numpy}.numeric", "_frombuffer"] = Token("frombuffer")
    for copy in ("copy_reg", "copyreg"):  # Python 2 and Python 3
        table[copy, "_reconstructor"] = Token("reconstructor")
        table[copy, "__newobj__"] = Token("newobj")
    for builtins in ("__builtin__", "builtins"):
        for kind in ("object", "set", "frozenset", "dict", "list", "bytes"):
            table[builtins, kind] = Token(kind)
    for kind in ("Select", "transpose", "reshape", "Reshape"):
        table["chumpy.reordering", kind] = Token(f"chumpy {kind.lower()}")
    for kind in ("csc", "csr", "coo"):
        for module in (f"scipy.sparse.{kind}", f"scipy.sparse._{kind}"):
            for form in ("matrix", "array"):
                table[module, f"{kind}_{form}"] = Token(f"sparse {kind}")
    return table


GLOBALS: Final = _table()


def find(module: Any, name: Any) -> Token:
    """Return the token of an allowed global.

    Raises
    ------
    ModelError
        For every other global; nothing is imported.
    """
    token = GLOBALS.get((module, name)) if isinstance(module, str) else None
    if token is None:
        raise ModelError(
            f"the file refers to {_shown(module)}.{_shown(name)}, which no model file needs; it is "
            "refused and nothing in it was run"
        )
    return token


def _shown(word: Any) -> str:
    """Return a word of the file's for a message: short, control characters escaped."""
    return ascii(word)[1:-1][:100] if isinstance(word, str) else f"a {type(word).__name__}"


def new(token: Any) -> Holder:
    """Return an empty holder of a class that a file may instantiate.

    Raises
    ------
    ModelError
        If the token is none of chumpy's or scipy's classes.
    """
    if isinstance(token, Token) and token.kind.startswith(("chumpy ", "sparse ")):
        return Holder(token.kind)
    raise ModelError("the file rebuilds an object that no model needs")


def call(token: Any, arguments: Any) -> Any:
    """Do what a file means by calling an allowed global: one of our own few steps.

    Raises
    ------
    ModelError
        If ``token`` is no callable of the table or the arguments are not those of a model file.
    """
    kind = token.kind if isinstance(token, Token) else None
    step = _STEPS.get(kind) if kind is not None else None
    if step is None or not isinstance(arguments, tuple):
        raise ModelError("the file calls an object that no model file calls; it was not run")
    try:
        return step(*arguments)
    except TypeError:
        raise ModelError(f"the file calls {kind} with {len(arguments)} odd arguments") from None


def _reconstruct(cls: Any, *_: Any) -> ArrayHolder:
    if cls != Token("ndarray"):
        raise ModelError("the file rebuilds an array of a class that no model needs")
    return ArrayHolder("array")


def _dtype(code: Any, *_: Any) -> DtypeHolder:
    return DtypeHolder(code)


def _scalar(dtype: Any, raw: Any = None) -> ArrayHolder:
    holder = ArrayHolder("scalar")
    holder.build(((), dtype, False, raw))
    return holder


def _frombuffer(raw: Any, dtype: Any, shape: Any, order: Any = "C") -> ArrayHolder:
    holder = ArrayHolder("array")
    holder.build((shape, dtype, order == "F", raw))
    return holder


def _reconstructor(cls: Any, base: Any, state: Any = None) -> Holder:
    if base != Token("object") or state is not None:
        raise ModelError("the file rebuilds an object from a base that no model needs")
    return new(cls)


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise ModelError("the file encodes text in a way that no model needs")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    """Return the data of an empty array, which old protocols write as a call."""
    return b""


def _list(items: Any = ()) -> list[Any]:
    if not isinstance(items, list | tuple | set):
        raise ModelError("a set or list in the file has no items")
    return list(items)


def _dict(items: Any = ()) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for pair in _list(items):
        key, value = pair if isinstance(pair, list | tuple) and len(pair) == 2 else (None, None)
        result[text_key(key)] = value
    return result


def text_key(key: Any) -> str:
    """Return a dictionary key; only text is allowed (its hashes cannot be made to collide)."""
    if isinstance(key, bytes):
        return key.decode("latin1")
    if not isinstance(key, str):
        raise ModelError(f"a dict in the file has {key!r:.40} for a key; expected text")
    return key


_STEPS: Final[dict[str, Any]] = {
    "reconstruct": _reconstruct, "dtype": _dtype, "scalar": _scalar, "frombuffer": _frombuffer,
    "reconstructor": _reconstructor, "newobj": new, "encode": _encode, "dict": _dict,
    "set": _list, "frozenset": _list, "list": _list,
    "bytes": _no_bytes,
}  # fmt: skip
