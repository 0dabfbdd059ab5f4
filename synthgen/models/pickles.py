"""Read the pickles of published models without executing anything in them.

The stream is first scanned opcode by opcode (nothing runs), then loaded by an unpickler whose
every global is one of our own inert holders: no code of numpy, scipy or chumpy is reachable.
"""

from __future__ import annotations

import io
import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError

MAX_BYTES = 400 * 2**20
MAX_OPCODES = 200_000
_FORBIDDEN = {
    "INST", "OBJ", "NEWOBJ_EX", "EXT1", "EXT2", "EXT4", "PERSID", "BINPERSID",
    "NEXT_BUFFER", "READONLY_BUFFER", "BYTEARRAY8",
}  # fmt: skip
_KINDS = {"f8", "f4", "i8", "i4", "u4", "u8", "u2", "i2", "u1", "i1", "b1"}


class _Holder:
    """Inert stand-in for a foreign object: keeps its state, does nothing with it."""

    def __init__(self) -> None:
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Dtype(_Holder):
    order = "<"

    def __init__(self, code: str = "") -> None:
        super().__init__()
        self.code = code

    def __setstate__(self, state: Any) -> None:
        if isinstance(state, tuple) and len(state) > 1 and state[1] in ("<", ">", "|", "="):
            self.order = "<" if state[1] in "=|" else state[1]

    def numpy(self) -> np.dtype[Any]:
        code = str(self.code).lstrip("<>|=")
        if code not in _KINDS:
            raise ModelError(f"array dtype {self.code!r}; allowed are {sorted(_KINDS)}")
        return np.dtype(self.order + code)


class _Array(_Holder):
    def numpy(self) -> NDArray[Any]:
        if not isinstance(self.state, tuple) or len(self.state) != 5:
            raise ModelError("an array in the file has no content")
        _, shape, dtype, fortran, data = self.state
        if not isinstance(dtype, _Dtype) or not isinstance(shape, tuple):
            raise ModelError("an array in the file has no dtype or shape")
        raw = data.encode("latin1") if isinstance(data, str) else data
        kind = dtype.numpy()
        if not isinstance(raw, bytes) or int(np.prod(shape)) * kind.itemsize != len(raw):
            raise ModelError(f"an array of shape {shape} does not match its bytes")
        flat = np.frombuffer(raw, dtype=kind)
        return flat.reshape(shape, order="F" if fortran else "C").astype(kind.newbyteorder("="))


class _Sparse(_Holder):
    pass


class _Chumpy(_Holder):
    pass


class _Select(_Chumpy):
    pass


def _reconstruct(*_: Any) -> _Array:
    return _Array()


def _dtype(code: Any, *_: Any) -> _Dtype:
    return _Dtype(str(code))


def _reconstructor(cls: Any, *_: Any) -> _Holder:
    if isinstance(cls, type) and issubclass(cls, _Holder):
        return cls()
    raise ModelError("the file rebuilds an object that no model needs")


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise ModelError("the file encodes text in a way that no model needs")
    return text.encode("latin1")


class _Ndarray(_Array):
    pass


_GLOBALS: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): _Ndarray,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("copy_reg", "_reconstructor"): _reconstructor,
    ("copyreg", "_reconstructor"): _reconstructor,
    ("builtins", "object"): _Holder,
    ("__builtin__", "object"): _Holder,
    ("chumpy.ch", "Ch"): _Chumpy,
    ("chumpy.reordering", "Select"): _Select,
}
for _module in ("numpy.core.multiarray", "numpy._core.multiarray"):
    _GLOBALS[_module, "_reconstruct"] = _reconstruct
for _kind in ("csc", "csr", "coo"):
    for _prefix in ("", "_"):
        _GLOBALS[f"scipy.sparse.{_prefix}{_kind}", f"{_kind}_matrix"] = _Sparse


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        try:
            return _GLOBALS[module, name]
        except KeyError:
            raise ModelError(
                f"the file refers to {module}.{name}, which no model file needs; it is refused "
                "and nothing in it was run"
            ) from None


def read_pickle(path: Path) -> dict[str, Any]:
    """Read a model pickle into a dict of arrays and strings.

    Parameters
    ----------
    path : Path
        A MANO-form ``.pkl`` (protocol 0-5, Python 2 or 3, chumpy and scipy objects allowed).

    Raises
    ------
    ModelError
        If the file is too large, truncated, hostile or holds no dict.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise ModelError(f"{path}: {size} bytes; a model pickle has at most {MAX_BYTES}")
    data = path.read_bytes()
    try:
        _scan(data)
        loaded = _Unpickler(io.BytesIO(data), encoding="latin1").load()
        if not isinstance(loaded, dict):
            raise ModelError(f"holds a {type(loaded).__name__}; a model pickle holds a dict")
        return {str(key): plain(value) for key, value in loaded.items()}
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
    except (RecursionError, MemoryError, OverflowError) as error:
        raise ModelError(f"{path}: not a model pickle ({type(error).__name__})") from None
    except Exception as error:
        raise ModelError(f"{path}: truncated or damaged pickle ({error})") from None


def _scan(data: bytes) -> None:
    for count, (opcode, _, _) in enumerate(pickletools.genops(data)):
        if opcode.name in _FORBIDDEN:
            raise ModelError(f"pickle opcode {opcode.name} is refused; no model file needs it")
        if count > MAX_OPCODES:
            raise ModelError(f"more than {MAX_OPCODES} pickle opcodes; no model file needs them")


def plain(value: Any) -> Any:
    """Turn a holder into the array it stands for; other values pass unchanged."""
    if isinstance(value, _Array):
        return value.numpy()
    if isinstance(value, _Sparse):
        return _dense(value.state)
    if isinstance(value, _Select):
        state = _state(value)
        source = np.asarray(plain(state["a"]), dtype=np.float64)
        picked = source.ravel()[np.asarray(plain(state["idxs"]), dtype=np.int64)]
        return picked.reshape(tuple(int(n) for n in _sequence(plain(state["preferred_shape"]))))
    if isinstance(value, _Chumpy):
        state = _state(value)
        return plain(state["x"] if "x" in state else state["_x"])
    return value


def _state(holder: _Holder) -> dict[str, Any]:
    if not isinstance(holder.state, dict):
        raise ModelError("a chumpy object in the file has no state")
    return holder.state


def _dense(state: Any) -> NDArray[np.float64]:
    from scipy import sparse

    if not isinstance(state, dict):
        raise ModelError("a sparse matrix in the file has no state")
    shape = tuple(int(n) for n in _sequence(state.get("_shape", state.get("shape"))))
    if len(shape) != 2 or int(np.prod(shape)) > 10**8:
        raise ModelError(f"a sparse matrix of shape {shape} is not a joint regressor")
    parts = {k: plain(v) for k, v in state.items() if isinstance(v, _Array)}
    matrix: Any
    if "indptr" in parts:
        triple = (parts["data"], parts["indices"], parts["indptr"])
        rows_first = len(parts["indptr"]) == shape[0] + 1
        build = sparse.csr_matrix if rows_first else sparse.csc_matrix
        matrix = build(triple, shape=shape)
    else:
        matrix = sparse.coo_matrix((parts["data"], (parts["row"], parts["col"])), shape=shape)
    return np.asarray(matrix.toarray(), dtype=np.float64)


def _sequence(value: Any) -> list[Any]:
    if isinstance(value, list | tuple | np.ndarray):
        return list(value)
    raise ModelError("an object in the file has no shape")
