"""Writing files so that they are either whole or absent, also when the process dies."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from synthgen.errors import CorpusError


def commit(path: Path, data: bytes) -> bool:
    """Create a file that must not exist yet: temporary file, fsync, link.

    Returns
    -------
    bool
        False where somebody else committed it first (their content stays).

    Raises
    ------
    CorpusError
        If the disk is full or the folder cannot be written; nothing is left behind.
    """
    temporary = _write_beside(path, data)
    try:
        os.link(temporary, path)
    except FileExistsError:
        return False
    finally:
        temporary.unlink(missing_ok=True)
    _sync_folder(path.parent)
    return True


def replace(path: Path, data: bytes) -> None:
    """Write a file that may exist: readers see the old content or the new, nothing between."""
    temporary = _write_beside(path, data)
    os.replace(temporary, path)
    _sync_folder(path.parent)


def put_in_place(part: Path, path: Path) -> None:
    """Give a finished file its name: its bytes reach the disk first."""
    with explained(part), open(part, "rb") as file:
        os.fsync(file.fileno())
    os.replace(part, path)
    _sync_folder(path.parent)


def make_folder(path: Path) -> None:
    """Create a folder and its parents.

    Raises
    ------
    CorpusError
        If it cannot be created or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CorpusError(
            f"cannot create the folder {path}: {error.strerror}; choose another --out"
        ) from None
    if not os.access(path, os.W_OK):
        raise CorpusError(f"the folder {path} cannot be written; choose another --out")


class Growing:
    """A file written piece by piece beside its place, and put there when it is whole.

    Only one process at a time may grow a path; what a dead one left is overwritten.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._temporary = path.with_name(f".{path.name}.tmp")
        with explained(path):
            self._file = open(self._temporary, "wb")  # closed by finish or abandon

    def write(self, data: bytes) -> None:
        """Append."""
        with explained(self.path):
            self._file.write(data)

    def finish(self) -> None:
        """Put the file in its place; readers see the old content or the new."""
        with explained(self.path), self._file:
            self._file.flush()
            os.fsync(self._file.fileno())
        os.replace(self._temporary, self.path)
        _sync_folder(self.path.parent)

    def abandon(self) -> None:
        """Remove what is not finished."""
        with suppress(OSError):
            self._file.close()
        self._temporary.unlink(missing_ok=True)


def _write_beside(path: Path, data: bytes) -> Path:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with explained(path), open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except CorpusError:
        temporary.unlink(missing_ok=True)
        raise
    return temporary


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn an operating system's error while writing ``path`` into one that says what to do."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        hint = "free some space and run the same command again" if full else "check its rights"
        raise CorpusError(f"cannot write {path}: {error.strerror}; {hint}") from None


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
