"""Opening a corpus."""

from __future__ import annotations

import json
import operator
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from synthgen.corpus import manifest, shards
from synthgen.corpus.checksums import SEAL, seal_of
from synthgen.corpus.columns import Members, key_of
from synthgen.corpus.sample import Sample, View
from synthgen.corpus.shards import Entry
from synthgen.errors import CorpusError, IntegrityError
from synthgen.sampling.spec import SampleSpec


class Corpus:
    """A finished corpus: a sequence of samples, and a table with a row per sample and view."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.manifest = _read_manifest(path)
        self._shard_of: dict[int, int] = {}
        self.sidecar_sha256: dict[int, str | None] = {}
        for entry in self.manifest["shards"]:
            self.sidecar_sha256[entry["shard"]] = entry.get("sidecar_sha256")
            shards.check_sizes(path, entry["shard"], entry["columns"])
            self._shard_of.update(dict.fromkeys(entry["samples"], entry["shard"]))
        self._indices = sorted(self._shard_of)
        # Indices of members are large: those of the shards read last are kept.
        self._sidecar = lru_cache(maxsize=8)(self._read_sidecar)

    def _read_sidecar(self, shard: int) -> dict[str, Any]:
        return shards.read_sidecar(self.path, shard, self.sidecar_sha256[shard])

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a path: workers of a data loader open it again."""
        return open_corpus, (self.path,)

    def __repr__(self) -> str:
        return f"<Corpus {str(self.path)!r}: {len(self)} samples>"

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, position: int) -> Sample:
        try:
            index = self._indices[operator.index(position)]
        except IndexError:
            raise IndexError(f"sample {position} of a corpus of {len(self)}") from None
        except TypeError:
            raise TypeError(
                f"corpus[{position!r}]: one whole number picks one sample; for several, write "
                "[corpus[k] for k in range(a, b)]"
            ) from None
        shard = self._shard_of[index]
        members = self._sidecar(shard)["columns"]["meta"]["members"]
        views: list[View] = []
        while (name := f"{key_of(index, len(views))}.json") in members:
            views.append(self._view(shard, name))
        if not views:
            raise IntegrityError(f"sample {index} has no meta in shard {shard}")
        try:
            spec = SampleSpec.from_json(views[0].meta["spec"])
        except (KeyError, TypeError) as error:
            raise IntegrityError(
                f"sample {index} in shard {shard} is damaged or of another version of synthgen "
                f"({type(error).__name__}: {error})"
            ) from None
        return Sample(index=index, views=tuple(views), spec=spec)

    def index_of(self, position: int) -> int:
        """Return the number of the sample at a position; parts of a plan begin anywhere."""
        return self._indices[position]

    def __iter__(self) -> Iterator[Sample]:
        return (self[k] for k in range(len(self)))

    def _view(self, shard: int, name: str) -> View:
        fetch = _Fetch(self, shard)
        try:
            meta: dict[str, Any] = json.loads(fetch("meta", name))
        except ValueError as error:
            raise IntegrityError(f"{name} in shard {shard} is damaged ({error})") from None
        return View(meta, fetch, frozenset(self._sidecar(shard)["columns"]))

    def member(self, shard: int, column: str, name: str) -> bytes:
        """Return the stored bytes of one member of a shard, by column and full name."""
        place = self._sidecar(shard)["columns"][column]["members"][name]
        return shards.read_member(self.path, column, shard, name, Entry(*place))

    def stored(self, position: int) -> dict[str, Members]:
        """Return all that is stored of a sample, as bytes: ``{column: {member name: bytes}}``."""
        index = self._indices[position]
        shard, mine = self._shard_of[index], key_of(index, 0)[:-2]
        return {
            column: {
                name: shards.read_member(self.path, column, shard, name, Entry(*place))
                for name, place in facts["members"].items()
                if name.startswith(mine)
            }
            for column, facts in self._sidecar(shard)["columns"].items()
        }

    @cached_property
    def table(self) -> pa.Table:
        """One row per sample and view: key, shard, sampled factors, visibility counts.

        Raises
        ------
        IntegrityError
            If its file is missing or damaged.
        """
        file = self.path / manifest.TABLE
        try:
            return pq.read_table(file)
        except (OSError, pa.ArrowException) as error:
            raise IntegrityError(
                f"{file} cannot be read ({error}); `synthgen generate` with the same arguments "
                "writes it anew"
            ) from None

    @property
    def shard_numbers(self) -> list[int]:
        """Numbers of the shards."""
        return sorted({entry["shard"] for entry in self.manifest["shards"]})


@dataclass(frozen=True, eq=False)
class _Fetch:
    """Reads members of one shard; views keep it, in other processes, too."""

    corpus: Corpus
    shard: int

    def __call__(self, column: str, member: str) -> bytes:
        return self.corpus.member(self.shard, column, member)


def open_corpus(path: str | Path) -> Corpus:
    """Open a corpus folder.

    Raises
    ------
    CorpusError
        If the folder holds no finished corpus.
    IntegrityError
        If a shard's files are missing or have other sizes than recorded.
    """
    return Corpus(Path(path))


def _read_manifest(path: Path) -> dict[str, Any]:
    file = path / manifest.MANIFEST
    if not path.is_dir():
        raise CorpusError(f"{path}: no such folder; name the folder of a corpus")
    if not file.is_file():
        raise CorpusError(
            f"{path} holds no {manifest.MANIFEST}: not a corpus, or not finished; "
            "`synthgen generate` with the same arguments finishes it"
        )
    try:
        content: dict[str, Any] = json.loads(file.read_bytes())
        sealed = SEAL in content or "files" in content  # older ones are not
        if sealed and content.get(SEAL) != seal_of(content):
            raise IntegrityError(f"{file} is damaged (its content differs from its {SEAL})")
        return {**content, "shards": list(content["shards"])}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise IntegrityError(f"{file} is damaged ({error})") from None
