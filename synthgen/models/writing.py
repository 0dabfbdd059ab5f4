"""Writing models out: a clean ``.npz``, or the official form of each family.

What is written is what was read: the file's arrays in their own precision, nothing mended and
nothing rounded, so that reading it back gives the same model (unless another hand or a part of a
body is asked for). A hand whose side only its file's name told gets the key ``hand`` where the new
name tells another.
"""

from __future__ import annotations

import io
import os
import struct
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models.build import side_of
from synthgen.models.content import META, META_PREFIX, SUFFIXES, Content
from synthgen.models.derived import hand_content, part_content
from synthgen.models.files import Pair, load_content
from synthgen.models.model import Hand
from synthgen.models.parts import PartName

# The form in which each family is published, beside the plain archive that all may have.
OFFICIAL = {"mano": ".pkl", "smplh": ".pkl", "supr": ".npy", "star": ".npz"}


def convert(
    source: str | Path,
    target: str | Path,
    *,
    mano: Pair | None = None,
    hand: Hand | None = None,
    part: PartName | None = None,
) -> Path:
    """Write a model's file in another form, its other hand, or a part of it.

    Parameters
    ----------
    source : str or Path
        A model's name or path.
    target : str or Path
        ``.npz``: arrays only, no pickle, any family. ``.pkl``: the official form of MANO and
        SMPL+H, a pickle (protocol 2) of plain arrays. ``.npy``: the official form of SUPR.
    mano : (left, right) or None
        As :func:`synthgen.models.load`; the pose spaces are written too.
    hand : "left", "right" or None
        Side of a hand to write: the file's own with its shape bases mended, or mirrored. None:
        what the file holds, unchanged.
    part : str or None
        Part of a body to write, see :func:`synthgen.models.separate`.

    Returns
    -------
    Path
        The file; it appears whole or not at all.

    Raises
    ------
    ModelError
        If the source cannot be read, or the target's suffix is none of its family's.
    """
    path = Path(target)
    content = load_content(source, mano=mano)
    content = content if hand is None else hand_content(content, hand)
    content = content if part is None else part_content(content, part)
    allowed = sorted({".npz", OFFICIAL[content.family or "star"]})
    if path.suffix not in allowed:
        raise ModelError(
            f"{path}: {path.suffix or 'no suffix'} is not how {content.family} models are written; "
            f"allowed are {' and '.join(allowed)}"
        )
    return write(_sided(content, path), path)


def _sided(content: Content, path: Path) -> Content:
    """Write the side into a hand's file whose new name would tell another one."""
    if content.family != "mano" or side_of(replace(content, path=path)) == side_of(content):
        return content
    return content.having(hand=np.array(side_of(content)))


def write(content: Content, path: Path) -> Path:
    """Write a content to ``.npz``, ``.pkl`` or ``.npy``; see :func:`convert`."""
    if path.suffix == ".npz":
        _whole(path, _npz(content))
    elif path.suffix in SUFFIXES:
        pickled = _Pickler().dumps(_values(content), wrapped=path.suffix == ".npy")
        _whole(path, pickled)
    else:
        raise ModelError(f"{path}: allowed are {', '.join(SUFFIXES)}")
    return path


def _npz(content: Content) -> bytes:
    meta = {f"{META_PREFIX}{key}": np.asarray(v) for key, v in (content.meta or {}).items()}
    stream = io.BytesIO()
    np.savez_compressed(stream, **content.arrays, **meta)  # type: ignore[arg-type]
    return stream.getvalue()


def _values(content: Content) -> dict[str, Any]:
    """Return arrays, text as text, and the nested ``axis_meta``."""
    values = {k: str(a) if a.dtype.kind in "US" and a.ndim == 0 else a
              for k, a in content.arrays.items()}  # fmt: skip
    return values if content.meta is None else {**values, META: content.meta}


def _whole(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".making-")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise ModelError(f"{path}: cannot be written ({error.strerror})") from None


class _Pickler:
    """Just enough of pickle for dicts of arrays, text, numbers and lists.

    It names numpy's functions by the module that numpy 1 and numpy 2 both know. A ``.pkl`` is of
    protocol 2 with array data as Python 2 wrote it, like the published files; what a ``.npy``
    wraps is of protocol 3, which numpy reads without being told an encoding.
    """

    def __init__(self) -> None:
        self.out = io.BytesIO()
        self.bytes_code = b"T"

    def dumps(self, value: dict[str, Any], *, wrapped: bool) -> bytes:
        """Return the pickle of a dict, or the ``.npy`` file of a 0-d array that holds it."""
        if wrapped:
            header = "{'descr': '|O', 'fortran_order': False, 'shape': (), }"
            pad = -(10 + len(header) + 1) % 64
            self.out.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + pad + 1))
            self.out.write((header + " " * pad + "\n").encode("ascii"))
        self.out.write(b"\x80\x03" if wrapped else b"\x80\x02")
        if wrapped:
            self.bytes_code = b"B"
            self._array_of((), "O8", "|", lambda: self._sequence([value], b"l"))
        else:
            self._value(value)
        self.out.write(b".")
        return self.out.getvalue()

    def _value(self, value: Any) -> None:
        put = self.out.write
        if isinstance(value, bool | np.bool_):
            put(b"\x88" if value else b"\x89")
        elif isinstance(value, int | np.integer):
            put(b"\x8a\x08" + int(value).to_bytes(8, "little", signed=True))
        elif isinstance(value, float | np.floating):
            put(b"G" + struct.pack(">d", value))
        elif isinstance(value, str):
            raw = value.encode("utf-8")
            put(b"X" + struct.pack("<I", len(raw)) + raw)
        elif isinstance(value, dict):
            self._sequence([part for item in value.items() for part in item], b"d")
        elif isinstance(value, list):
            self._sequence(value, b"l")
        elif isinstance(value, tuple):
            self._sequence(value, b"t")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biufUS":
            self._array(value)
        else:
            raise ModelError(f"a {type(value).__name__} is not written into a model file")

    def _sequence(self, items: Any, code: bytes) -> None:
        self.out.write(b"(")
        for item in items:
            self._value(item)
        self.out.write(code)

    def _array(self, array: NDArray[Any]) -> None:
        plain = np.ascontiguousarray(array).reshape(array.shape)
        kind = plain.dtype.str
        self._array_of(plain.shape, kind[1:], kind[0], lambda: self._bytes(plain.tobytes()))

    def _array_of(self, shape: tuple[int, ...], code: str, order: str, data: Any) -> None:
        put = self.out.write
        put(b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00t")
        self._bytes(b"b")
        put(b"tR(K\x01")
        self._value(shape)
        put(b"cnumpy\ndtype\n(")
        self._value(code)
        put(b"\x89\x88tR(K\x03")
        self._value(order)
        size = int(code[1:]) * 4 if code[0] == "U" else int(code[1:])
        text = code[0] in "US"
        put(b"NNN")
        self._value(size if text else -1)
        self._value((4 if code[0] == "U" else 1) if text else -1)
        self._value(63 if code[0] == "O" else 0)
        put(b"tb\x89")
        data()
        put(b"tb")

    def _bytes(self, raw: bytes) -> None:
        self.out.write(self.bytes_code + struct.pack("<I", len(raw)) + raw)
