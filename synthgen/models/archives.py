"""Read ``.npz`` archives and ``.npy`` files without trusting a size that they declare.

Everything that numpy would allocate is compared with the bytes that are there first; members that
hold objects go through the pickle machine of :mod:`synthgen.models.pickles`.
"""

from __future__ import annotations

import ast
import math
import re
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models.holders import MAX_ITEM_BYTES
from synthgen.models.pickles import MAX_BYTES, read_bytes, unpickled

MAX_MEMBERS = 512
# An archive may unpack to this much, or to this many times its own size if that is more.
FREE_BYTES = 32 * 2**20
MAX_RATIO = 64
_MAX_DIRECTORY = 2**20
_MAX_HEADER = 4096
MAGIC = b"\x93NUMPY"
_END_BYTES = 22
# One plain number or text type; numpy would also read "3f8" and "f2,f2", which are records.
_DTYPE = re.compile(r"[<>|=]?[biufSU]\d{1,7}")


def read_npz(path: Path) -> dict[str, Any]:
    """Read an archive of arrays.

    Parameters
    ----------
    path : Path
        A ``.npz``; members may hold pickled objects, which become plain values.

    Returns
    -------
    dict
        Key to array, text (0-d text arrays stay arrays) or what an object member holds.

    Raises
    ------
    ModelError
        If the archive is damaged, hostile, or unpacks to more than a model can need.
    """
    try:
        size = check_directory(path)
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _check_members(members, size)
            return {_key(m): _member(archive, m) for m in members}
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
    except (
        OSError, ValueError, EOFError, KeyError, MemoryError, NotImplementedError, RuntimeError,
        RecursionError, SyntaxError, struct.error, zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise ModelError(f"{path}: not a readable model archive ({error})") from None


def read_bytes_of(path: Path) -> bytes:
    """Read a whole file; errors name it."""
    try:
        return read_bytes(path)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


def npy_value(data: bytes | memoryview) -> Any:
    """Return what the bytes of a ``.npy`` file hold.

    Raises
    ------
    ModelError
        If header and size disagree, or an object in it is refused.
    """
    dtype, shape, fortran, start = _header(data)
    if dtype == "O":
        value = unpickled(bytes(data), start)
        return value[0] if shape == () and isinstance(value, list) and len(value) == 1 else value
    return _array(data, dtype, shape, fortran, start)


def _array(
    data: bytes | memoryview,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    fortran: bool,
    start: int,
) -> NDArray[Any]:
    wanted = math.prod(shape) * dtype.itemsize
    if wanted != len(data) - start:
        raise ModelError(
            f"an array declares shape {shape} and dtype {dtype}, {wanted} bytes, but "
            f"{len(data) - start} are there"
        )
    if not wanted:
        return _empty(dtype, shape)
    array = np.frombuffer(data, dtype=dtype, offset=start, count=math.prod(shape))
    shaped = array.reshape(shape, order="F" if fortran else "C")
    return shaped if dtype.isnative else shaped.astype(dtype.newbyteorder("="))


def _empty(dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    try:
        return np.zeros(shape, dtype)
    except ValueError:
        raise ModelError(f"an array declares shape {shape}") from None


def _header(data: bytes | memoryview) -> tuple[Any, tuple[int, ...], bool, int]:
    """Read dtype ("O" for objects), shape, order and where the content starts."""
    if data[:6] != MAGIC or len(data) < 12 or data[6] not in (1, 2, 3):
        raise ModelError("a member is no .npy array (its first bytes are not those of one)")
    long = data[6] > 1
    (size,) = struct.unpack_from("<I" if long else "<H", data, 8)
    start = (12 if long else 10) + size
    if size > _MAX_HEADER or start > len(data):
        raise ModelError(f"an array header of {size} bytes; at most {_MAX_HEADER} are read")
    try:
        header = ast.literal_eval(bytes(data[start - size : start]).decode("utf-8").strip())
    except (ValueError, SyntaxError, RecursionError, MemoryError, TypeError):
        raise ModelError("an array header is not readable") from None
    if not isinstance(header, dict) or set(header) != {"descr", "fortran_order", "shape"}:
        raise ModelError("an array header lacks descr, fortran_order or shape")
    shape = header["shape"]
    if (
        not isinstance(shape, tuple)
        or len(shape) > 8
        or any(type(n) is not int or not 0 <= n < 2**48 for n in shape)
    ):
        raise ModelError(f"an array header has shape {shape!r:.80}")
    return _dtype(header["descr"]), shape, bool(header["fortran_order"]), start


def _dtype(descr: Any) -> Any:
    if descr in ("|O", "O", "<O", "|O8"):
        return "O"
    if isinstance(descr, str) and _DTYPE.fullmatch(descr):
        try:
            dtype = np.dtype(descr)
        except TypeError:
            dtype = np.dtype("V0")
        if 0 < dtype.itemsize <= 1024 * MAX_ITEM_BYTES and not dtype.hasobject:
            return dtype
    raise ModelError(f"an array of dtype {descr!r:.60}; expected numbers, text or objects")


def check_directory(path: Path) -> int:
    """Refuse an archive whose directory alone would take long to read; return its size.

    Raises
    ------
    ModelError
        If it is no archive of a model; without the file's name.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise ModelError(f"{size} bytes; a model file has at most {MAX_BYTES}")
    with path.open("rb") as stream:
        stream.seek(max(0, size - 2**16 - _END_BYTES))
        tail = stream.read()
    end = tail.rfind(b"PK\x05\x06")
    if end < 0 or end + _END_BYTES > len(tail):
        raise ModelError("not a readable model archive (no directory at its end; cut short?)")
    count, directory = struct.unpack_from("<HI", tail, end + 10)
    large = tail[max(end - 20, 0) :][:4] == b"PK\x06\x07"
    if count > MAX_MEMBERS or directory > _MAX_DIRECTORY or large:
        raise ModelError(
            f"an archive of {count} members with a directory of {directory} bytes; a model has at "
            f"most {MAX_MEMBERS} members"
        )
    return size


def _check_members(members: list[zipfile.ZipInfo], size: int) -> None:
    names = [_key(m) for m in members]  # "v" and "v.npy" are one key
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ModelError(f"the archive has two members of one name, {twice!r:.60}")
    total = sum(m.file_size for m in members)
    allowed = min(MAX_BYTES, max(FREE_BYTES, MAX_RATIO * size))
    if total > allowed:
        largest = max(members, key=lambda m: m.file_size)
        raise ModelError(
            f"{largest.filename} has {largest.file_size} bytes, all members {total}; an archive "
            f"of {size} bytes may unpack to {allowed}"
        )
    for m in members:
        if m.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ModelError(f"{m.filename} is compressed in a way that numpy does not write")


def printable(key: str) -> str:
    """Return a key that a file chose, fit for a message: short, control characters escaped."""
    shown = key if key.isprintable() else ascii(key)[1:-1]
    return shown if len(shown) <= 60 else f"{shown[:60]}..."


def _key(member: zipfile.ZipInfo) -> str:
    return member.filename.removesuffix(".npy")


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Any:
    try:
        return npy_value(archive.read(member))
    except ModelError as error:
        raise ModelError(f"{printable(_key(member))}: {error}") from None
