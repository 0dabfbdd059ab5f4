"""Shards: a run of samples as one tar per column, and the sidecar that makes it count.

A shard is done if and only if its sidecar exists; it is committed last, after every tar. The
sidecar has a checksum of every tar, and of every member, so that a damaged one is never decoded.
"""

from __future__ import annotations

import hashlib
import json
import os
import tarfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synthgen.corpus import atomic
from synthgen.corpus.checksums import file_sha256
from synthgen.corpus.columns import Members
from synthgen.errors import CorpusError, IntegrityError

SIDECARS = "shards"


@dataclass(frozen=True)
class Entry:
    """Where a member lies in its column's tar: offset, length and CRC-32 of its bytes."""

    offset: int
    size: int
    crc32: int


def tar_path(corpus: Path, column: str, shard: int) -> Path:
    """Return the path of one column of one shard."""
    return corpus / column / f"{shard:06d}.tar"


def sidecar_path(corpus: Path, shard: int) -> Path:
    """Return the path of a shard's sidecar."""
    return corpus / SIDECARS / f"{shard:06d}.json"


class ShardWriter:
    """Writes the tars of one shard member by member, so that memory does not grow with it.

    The caller holds the shard's claim. Use as a context: what is not committed is removed. The
    bytes of a tar depend on its members' names, contents and order alone.
    """

    def __init__(self, corpus: Path, shard: int, columns: tuple[str, ...]) -> None:
        self._corpus, self._shard = corpus, shard
        self._tars: dict[str, _Tar] = {}
        for column in columns:
            self._tars[column] = _Tar(tar_path(corpus, column, shard))

    def __enter__(self) -> ShardWriter:
        return self

    def __exit__(self, *_: object) -> None:
        for tar in self._tars.values():
            tar.file.abandon()

    def add(self, column: str, members: Members) -> None:
        """Append members ``{KEY.suffix: bytes}``, by name."""
        for name in sorted(members):
            self._tars[column].add(name, members[name])

    def commit(self, facts: dict[str, Any]) -> None:
        """Put every tar in its place, then the sidecar with ``facts`` (samples, attempts)."""
        columns = {column: tar.finish() for column, tar in self._tars.items()}
        sidecar = {"shard": self._shard, "columns": columns, **facts}
        text = json.dumps(sidecar, sort_keys=True, separators=(",", ":")).encode()
        atomic.commit(sidecar_path(self._corpus, self._shard), text)


class _Tar:
    """A growing USTAR archive, its index and its checksum."""

    def __init__(self, path: Path) -> None:
        self.file = atomic.Growing(path)
        self._hash = hashlib.sha256()
        self._size = 0
        self._members: dict[str, list[int]] = {}

    def _write(self, data: bytes) -> None:
        self.file.write(data)
        self._hash.update(data)
        self._size += len(data)

    def add(self, name: str, data: bytes) -> None:
        info = tarfile.TarInfo(name)
        info.size, info.mtime, info.mode = len(data), 0, 0o644
        self._write(info.tobuf(tarfile.USTAR_FORMAT))
        self._members[name] = [self._size, len(data), zlib.crc32(data)]
        self._write(data + bytes(-len(data) % tarfile.BLOCKSIZE))

    def finish(self) -> dict[str, Any]:
        end = self._size + 2 * tarfile.BLOCKSIZE
        self._write(bytes(end - self._size + -end % tarfile.RECORDSIZE))
        self.file.finish()
        return {"bytes": self._size, "sha256": self._hash.hexdigest(), "members": self._members}


def sidecar_sha256(corpus: Path, shard: int) -> str:
    """Return the SHA-256 of a shard's sidecar."""
    return file_sha256(sidecar_path(corpus, shard))


def read_sidecar(corpus: Path, shard: int, sha256: str | None = None) -> dict[str, Any]:
    """Read a sidecar and check the sizes of its tars.

    Parameters
    ----------
    corpus : Path
    shard : int
    sha256 : str or None
        What the manifest recorded of the sidecar's bytes; None where nothing did.

    Raises
    ------
    IntegrityError
        If the sidecar is missing, unreadable or another one, or a tar is missing or has another
        size.
    """
    path = sidecar_path(corpus, shard)
    again = "run generate again"
    try:
        data = path.read_bytes()
        if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
            raise IntegrityError(
                f"{path}: its bytes differ from their checksum in MANIFEST.json; delete it and "
                f"{again}"
            )
        sidecar: dict[str, Any] = json.loads(data)
        columns = sidecar["columns"]
    except FileNotFoundError:
        raise IntegrityError(
            f"{path} is missing: a run that makes the shard anew is not finished; {again}"
        ) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise IntegrityError(f"{path}: unreadable sidecar ({error})") from None
    check_sizes(corpus, shard, columns)
    return sidecar


def check_sizes(corpus: Path, shard: int, columns: dict[str, Any]) -> None:
    """Check that every tar of a shard is there with as many bytes as recorded.

    Raises
    ------
    IntegrityError
        Naming the tar.
    """
    again = f"delete {sidecar_path(corpus, shard)} and run generate again"
    for column, facts in columns.items():
        tar = tar_path(corpus, column, shard)
        if not tar.is_file():
            raise IntegrityError(f"{tar} is missing; {again}")
        if tar.stat().st_size != facts["bytes"]:
            raise IntegrityError(
                f"{tar} has {tar.stat().st_size} bytes, {facts['bytes']} are recorded; {again}"
            )


def check_hashes(corpus: Path, shard: int, sha256: str | None = None) -> None:
    """Rehash every tar of a shard, and its sidecar; arguments as :func:`read_sidecar`.

    Raises
    ------
    IntegrityError
        Naming the file whose bytes changed.
    """
    for column, facts in read_sidecar(corpus, shard, sha256)["columns"].items():
        tar = tar_path(corpus, column, shard)
        if file_sha256(tar) != facts["sha256"]:
            raise IntegrityError(f"{tar}: its bytes differ from the checksum in its sidecar")


def read_member(corpus: Path, column: str, shard: int, name: str, entry: Entry) -> bytes:
    """Read one member by its place, without scanning the tar, and check its bytes.

    Raises
    ------
    IntegrityError
        Naming the tar and the member whose bytes changed.
    """
    path = tar_path(corpus, column, shard)
    handle = os.open(path, os.O_RDONLY)
    try:
        data = os.pread(handle, entry.size, entry.offset)
    finally:
        os.close(handle)
    if len(data) != entry.size:
        raise IntegrityError(f"{path} ends before byte {entry.offset + entry.size}")
    if zlib.crc32(data) != entry.crc32:
        raise IntegrityError(
            f"{path}: the bytes of {name} differ from their checksum; delete "
            f"{sidecar_path(corpus, shard)} and run generate again to make the shard anew"
        )
    return data


def done_shards(corpus: Path) -> list[int]:
    """Return the numbers of committed shards, in order."""
    return sorted(int(path.stem) for path in (corpus / SIDECARS).glob("[0-9]*.json"))


def drop_shard(corpus: Path, shard: int) -> None:
    """Take a shard back (its sidecar first), so that it is made again."""
    try:
        sidecar_path(corpus, shard).unlink(missing_ok=True)
    except OSError as error:
        raise CorpusError(f"cannot remove shard {shard} of {corpus}: {error.strerror}") from None
