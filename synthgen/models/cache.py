"""A load cache: what was once read and checked is kept as plain arrays, by the file's SHA-256.

An entry is a folder of ``.npy`` files and an ``index.json`` with a CRC of each; it appears
whole or not at all, and one that does not fit its checksums is made again. Nothing in it is
pickled. ``SYNTHGEN_CACHE`` names the folder, else ``XDG_CACHE_HOME`` or ``~/.cache`` holds it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import time
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models.archives import npy_value
from synthgen.models.content import Content
from synthgen.models.pickles import MAX_BYTES

# Smaller files are read again faster than they are looked up.
MIN_BYTES = 8 * 2**20
_VERSION = 3
# An index names a few dozen arrays.
_MAX_INDEX = 2**20
# A file changed less than this before it was hashed may change again within one time stamp.
_SETTLED_NS = 2 * 10**9


def cache_folder() -> Path:
    """Return where entries are kept."""
    own = os.environ.get("SYNTHGEN_CACHE")
    if own:
        return Path(own) / "models"
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "synthgen" / "models"


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file; that of an unchanged file (path, size, times) is remembered.

    Raises
    ------
    ModelError
        If the file cannot be read, or is larger than any model: hashing it would take minutes.
    """
    try:
        stat = path.stat()
        if stat.st_size > MAX_BYTES:
            raise ModelError(f"{path}: {stat.st_size} bytes; a model file has at most {MAX_BYTES}")
        stamp = [str(path), stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino]
        note = cache_folder() / f"{hashlib.sha256(str(path).encode()).hexdigest()[:32]}.json"
        known = _json(note)
        if known.get("stamp") == stamp and isinstance(known.get("sha256"), str):
            return str(known["sha256"])
        with path.open("rb") as stream:
            found = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    if stat.st_size >= MIN_BYTES and time.time_ns() - stat.st_ctime_ns > _SETTLED_NS:
        with suppress(OSError):
            note.parent.mkdir(parents=True, exist_ok=True)
            _write(note, json.dumps({"stamp": stamp, "sha256": found}).encode())
    return found


def cached(key: str, path: Path) -> Content | None:
    """Return the entry of a key, or None where there is none or it is damaged.

    Parameters
    ----------
    key : str
        SHA-256 of the file (or over those of several files).
    path : Path
        The file that it stands for; errors name it.
    """
    folder = cache_folder() / key
    index = _json(folder / "index.json")
    if index.get("version") != _VERSION or index.get("check") != _check(index):
        return None
    try:
        arrays = {k: _checked(folder, k, total) for k, total in index["arrays"].items()}
        meta = index["meta"] and {k: _checked(folder, f"meta-{k}", t)
                                  for k, t in index["meta"].items()}  # fmt: skip
        return Content(
            path, arrays, meta or None, index["family"], index["digest"], index["sha256"],
            tuple(index["warnings"]),
        )  # fmt: skip
    except (OSError, KeyError, TypeError, AttributeError, ModelError):
        return None


def keep(key: str, content: Content) -> None:
    """Store a checked content; a folder that cannot be written is no failure."""
    root = cache_folder()
    with suppress(OSError, ValueError):  # nested lists in axis_meta have no plain array
        root.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=".making-", dir=root))
        try:
            meta = {k: _save(made, f"meta-{k}", np.asarray(v))
                    for k, v in (content.meta or {}).items()}  # fmt: skip
            index = {
                "version": _VERSION,
                "family": content.family,
                "digest": content.digest,
                "sha256": content.sha256,
                "warnings": list(content.warnings),
                "meta": meta,
                "arrays": {k: _save(made, k, v) for k, v in content.arrays.items()},
            }
            _write(made / "index.json", json.dumps({**index, "check": _check(index)}).encode())
            shutil.rmtree(root / key, ignore_errors=True)
            made.rename(root / key)
        finally:
            shutil.rmtree(made, ignore_errors=True)


def _save(folder: Path, key: str, array: NDArray[Any]) -> int:
    path = _file(folder, key)
    np.save(path, np.ascontiguousarray(array).reshape(array.shape), allow_pickle=False)
    return zlib.crc32(np.fromfile(path, dtype=np.uint8).data)


def _checked(folder: Path, key: str, total: int) -> NDArray[Any]:
    path = _file(folder, key)
    if not path.is_file() or path.stat().st_size > 2 * MAX_BYTES:
        raise ModelError(f"{key} is none of our files")
    data = np.empty(path.stat().st_size, dtype=np.uint8)  # aligned and writable, read in place
    with path.open("rb") as stream:
        size = stream.readinto(data.data)
    if size != len(data) or zlib.crc32(data.data) != total:
        raise ModelError(f"{key} differs from its checksum")
    value = npy_value(data.data)
    if not isinstance(value, np.ndarray):
        raise ModelError(f"{key} is no array")
    return value


def _file(folder: Path, key: str) -> Path:
    """Return the file of a key, whatever characters it has."""
    safe = all(c.isalnum() or c in "_-" for c in key) and key.isascii() and len(key) < 100
    return folder / f"{key if safe else hashlib.sha256(key.encode()).hexdigest()}.npy"


def _check(index: dict[str, Any]) -> str:
    """Return the SHA-256 of an index, its own left out."""
    rest = {k: v for k, v in index.items() if k != "check"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _json(path: Path) -> dict[str, Any]:
    try:
        if not path.is_file() or path.stat().st_size > _MAX_INDEX:  # a pipe would never end
            return {}
        content = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _write(path: Path, data: bytes) -> None:
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".making-")
    with os.fdopen(handle, "wb") as stream:
        stream.write(data)
    os.replace(temporary, path)
