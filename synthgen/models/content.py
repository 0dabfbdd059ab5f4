"""What a model file holds: arrays and text by key, whatever the file's form."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models.archives import (
    MAGIC,
    check_directory,
    npy_value,
    printable,
    read_bytes_of,
    read_npz,
)
from synthgen.models.model import Family
from synthgen.models.pickles import MAX_BYTES, starts_well, unpickled_dict

Array = NDArray[np.float64]
SUFFIXES = (".npz", ".pkl", ".npy")
# The nested dict of constrained SUPR files; in an archive its keys stand beside the others.
META = "axis_meta"
META_PREFIX = "axis_meta_"
# Characters of a text, or of a table of names, that are still taken for one.
_TEXT = 2**16


@dataclass(frozen=True, eq=False)
class Content:
    """A model file's content.

    Attributes
    ----------
    path : Path
    arrays : dict of str to array
        Numbers and text as in the file, its own dtypes; objects of no use are left out.
    meta : dict or None
        ``axis_meta`` of a constrained SUPR file.
    family : str
        "mano", "smplh", "supr" or "star" once the arrays are checked, before that empty.
    digest : str
        SHA-256 over the arrays of the model, once they are checked.
    sha256 : str
        Of the file itself, where it is a user's.
    warnings : tuple of str
        What a user should know about the file.
    """

    path: Path
    arrays: dict[str, NDArray[Any]]
    meta: dict[str, Any] | None = None
    family: Family | Literal[""] = ""
    digest: str = ""
    sha256: str = ""
    warnings: tuple[str, ...] = field(default=())

    def fail(self, words: str) -> ModelError:
        """Return an error that names the file."""
        return ModelError(f"{self.path}: {words}")

    def keys_text(self) -> str:
        """Return the file's keys for a message: a few, short, and without control characters."""
        keys = sorted(self.arrays)
        more = f" and {len(keys) - 20} more" if len(keys) > 20 else ""
        return ", ".join(map(printable, keys[:20])) + more if keys else "none"

    def check_size(self) -> None:
        """Refuse what would fill memory once it is read as float64.

        Raises
        ------
        ModelError
            Naming the largest array.
        """
        total = 8 * sum(array.size for array in self.arrays.values())
        if total > MAX_BYTES:
            key = max(self.arrays, key=lambda k: self.arrays[k].size)
            raise self.fail(
                f"its arrays take {total} bytes as float64 (the largest, {printable(key)}, is "
                f"{self.arrays[key].shape}); a model has at most {MAX_BYTES}"
            )

    def numbers(self, key: str) -> Array:
        """Return an array as float64.

        Raises
        ------
        ModelError
            If the key is missing or holds no numbers.
        """
        if key not in self.arrays:
            raise self.fail(f"no {key}; it has {self.keys_text()}")
        array = self.arrays[key]
        if array.dtype.kind not in "fiub":
            raise self.fail(f"{key} holds {array.dtype}; expected numbers")
        return np.asarray(array, dtype=np.float64)

    def owned(self, key: str) -> Array:
        """Return an array as :meth:`numbers`, aligned and in one piece.

        What a file's bytes hold is neither; compiled kernels would be made again for it.
        """
        return np.require(self.numbers(key), np.float64, ["C", "A", "W"])

    def optional(self, key: str) -> Array | None:
        """Return an array as :meth:`owned`, or None where the file lacks it."""
        return self.owned(key) if key in self.arrays else None

    def ids(self, key: str) -> NDArray[np.int64]:
        """Return an array of whole numbers."""
        return self.numbers(key).astype(np.int64)

    def text(self, key: str, default: str = "") -> str:
        """Return a text, or ``default`` where the file lacks it."""
        return str(self.arrays[key]) if key in self.arrays else default

    def having(self, **arrays: NDArray[Any]) -> Content:
        """Return the same with some arrays added or replaced."""
        return replace(self, arrays={**self.arrays, **arrays})


def check_ends(path: Path) -> None:
    """Refuse what no model file starts or ends with, before hundreds of megabytes are read.

    Raises
    ------
    ModelError
        If the file is no archive, array or pickle, is too large or cannot be read.
    """
    try:
        if (size := path.stat().st_size) > MAX_BYTES:
            raise ModelError(f"{size} bytes; a model file has at most {MAX_BYTES}")
        if path.suffix == ".npz":
            check_directory(path)
            return
        with path.open("rb") as stream:
            head = stream.read(len(MAGIC))
        if head != MAGIC and not starts_well(head):
            raise ModelError(
                f"starts with {head!r}, as no model file does; was a web page or a pointer saved "
                "in its place?"
            )
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None


def read_content(path: Path) -> Content:
    """Read a ``.npz``, ``.pkl`` or ``.npy``; nothing in it is executed.

    Raises
    ------
    ModelError
        If the file is unreadable, hostile or no dict of arrays.
    """
    if path.suffix == ".npz":
        return contained(path, read_npz(path))
    data = read_bytes_of(path)
    try:
        value = npy_value(data) if data[:6] == MAGIC else unpickled_dict(data)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
    if not isinstance(value, dict):
        raise ModelError(f"{path}: holds one {type(value).__name__}; a model is a dict of arrays")
    return contained(path, value)


def contained(path: Path, values: dict[str, Any]) -> Content:
    """Sort a file's values into arrays, text and the nested ``axis_meta``."""
    arrays = {k: a for k, v in values.items() if (a := _array(v)) is not None}
    meta = values.get(META)
    flat = {k.removeprefix(META_PREFIX): v for k, v in arrays.items() if k.startswith(META_PREFIX)}
    if flat:
        arrays = {k: v for k, v in arrays.items() if not k.startswith(META_PREFIX)}
        meta = flat
    if meta is not None and not isinstance(meta, dict):
        raise ModelError(f"{path}: {META} is a {type(meta).__name__}; expected a dict")
    return Content(path, arrays, meta)


def _array(value: Any) -> NDArray[Any] | None:
    """Return numbers and text as an array; None for what is neither."""
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, bytes):
        value = value.decode("latin1")
    if isinstance(value, str):
        return np.asarray(value) if len(value) <= _TEXT else None
    if isinstance(value, bool | int | float):
        array = np.asarray(value)
        return array if array.dtype.kind in "biuf" else None
    if isinstance(value, list) and all(isinstance(v, str) for v in value):
        wide = len(value) * max(map(len, value), default=0)
        return np.array(value, dtype=str) if wide <= _TEXT else None
    if isinstance(value, list) and value and all(isinstance(v, int | float) for v in value):
        return np.array(value, dtype=np.float64)
    return None


def digest_of(content: Content, keys: Iterable[str]) -> str:
    """Return the SHA-256 over arrays, read as float64, in the order of their keys."""
    total = hashlib.sha256()
    for key in sorted(keys):
        array = content.numbers(key)
        total.update(key.encode() + str(array.shape).encode())
        total.update(np.ascontiguousarray(array).data.cast("B"))
    return total.hexdigest()
