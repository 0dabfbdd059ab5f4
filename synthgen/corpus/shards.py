"""Shards: a run of samples as one tar per column, and the sidecar that makes it count.

A shard is done if and only if its sidecar exists; it is committed last, after every tar.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import tarfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synthgen.corpus import atomic
from synthgen.corpus.columns import Members
from synthgen.errors import CorpusError, IntegrityError

SIDECARS = "shards"


@dataclass(frozen=True)
class Entry:
    """Where a member lies in its column's tar: offset and length of its bytes."""

    offset: int
    size: int


def tar_path(corpus: Path, column: str, shard: int) -> Path:
    """Return the path of one column of one shard."""
    return corpus / column / f"{shard:06d}.tar"


def sidecar_path(corpus: Path, shard: int) -> Path:
    """Return the path of a shard's sidecar."""
    return corpus / SIDECARS / f"{shard:06d}.json"


def pack(members: Members) -> tuple[bytes, dict[str, Entry]]:
    """Pack members by name into a tar whose bytes depend on nothing else."""
    buffer = io.BytesIO()
    index: dict[str, Entry] = {}
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name in sorted(members):
            info = tarfile.TarInfo(name)
            info.size, info.mtime, info.mode = len(members[name]), 0, 0o644
            archive.addfile(info, io.BytesIO(members[name]))
            index[name] = Entry(archive.offset - _padded(info.size), info.size)
    return buffer.getvalue(), index


def _padded(size: int) -> int:
    return -(-size // tarfile.BLOCKSIZE) * tarfile.BLOCKSIZE


def commit_shard(
    corpus: Path, shard: int, columns: dict[str, Members], facts: dict[str, Any]
) -> None:
    """Write every column's tar, then the sidecar.

    The caller holds the shard's claim. Tars left by a writer that died are replaced.

    Parameters
    ----------
    corpus : Path
    shard : int
    columns : dict
        Members ``{KEY.suffix: bytes}`` by column.
    facts : dict
        Further JSON content of the sidecar: samples, attempts.
    """
    described: dict[str, Any] = {}
    for column, members in columns.items():
        data, index = pack(members)
        atomic.replace(tar_path(corpus, column, shard), data)
        described[column] = {
            "bytes": len(data),
            "sha256": hashlib.sha256(data).hexdigest(),
            "members": {name: [entry.offset, entry.size] for name, entry in index.items()},
        }
    sidecar = {"shard": shard, "columns": described, **facts}
    text = json.dumps(sidecar, sort_keys=True, separators=(",", ":")).encode()
    atomic.commit(sidecar_path(corpus, shard), text)


def read_sidecar(corpus: Path, shard: int) -> dict[str, Any]:
    """Read a sidecar and check the sizes of its tars.

    Raises
    ------
    IntegrityError
        If the sidecar is unreadable, or a tar is missing or has another size.
    """
    path = sidecar_path(corpus, shard)
    try:
        sidecar: dict[str, Any] = json.loads(path.read_bytes())
        columns = sidecar["columns"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise IntegrityError(f"{path}: unreadable sidecar ({error})") from None
    for column, facts in columns.items():
        tar = tar_path(corpus, column, shard)
        if not tar.is_file():
            raise IntegrityError(f"{tar} is missing; delete {path} and run generate again")
        if tar.stat().st_size != facts["bytes"]:
            raise IntegrityError(
                f"{tar} has {tar.stat().st_size} bytes, its sidecar says {facts['bytes']}; "
                f"delete {path} and run generate again"
            )
    return sidecar


def check_hashes(corpus: Path, shard: int) -> None:
    """Rehash every tar of a shard.

    Raises
    ------
    IntegrityError
        Naming the tar whose bytes changed.
    """
    for column, facts in read_sidecar(corpus, shard)["columns"].items():
        tar = tar_path(corpus, column, shard)
        if hashlib.sha256(tar.read_bytes()).hexdigest() != facts["sha256"]:
            raise IntegrityError(f"{tar}: its bytes differ from the checksum in its sidecar")


def read_member(corpus: Path, column: str, shard: int, entry: Entry) -> bytes:
    """Read one member by its place, without scanning the tar."""
    path = tar_path(corpus, column, shard)
    handle = os.open(path, os.O_RDONLY)
    try:
        data = os.pread(handle, entry.size, entry.offset)
    finally:
        os.close(handle)
    if len(data) != entry.size:
        raise IntegrityError(f"{path} ends before byte {entry.offset + entry.size}")
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
