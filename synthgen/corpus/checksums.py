"""Whether a corpus's own files are what ``MANIFEST.json`` recorded of them.

Tars are rehashed by :func:`synthgen.corpus.shards.check_hashes`; here is all the rest. A corpus may
be about to grow: of a longer plan the rows that were there count, of the configuration all but the
number of samples.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SEAL = "manifest_sha256"
CONFIG = "config.resolved.yaml"
_BLOCK = 2**20


def file_sha256(path: Path, first: int | None = None) -> str:
    """Return the SHA-256 of a file, or of its first bytes."""
    total, left = hashlib.sha256(), path.stat().st_size if first is None else first
    with open(path, "rb") as file:
        while left > 0 and (block := file.read(min(left, _BLOCK))):
            total.update(block)
            left -= len(block)
    return total.hexdigest()


def config_sha256(path: Path) -> str:
    """Return the SHA-256 of a resolved configuration but for ``samples``; "" where it is missing.

    Of its text, not of what it means: a later schema may have other keys.
    """
    try:
        lines = path.read_bytes().splitlines(keepends=True)
    except OSError:
        return ""
    kept = b"".join(line for line in lines if not line.startswith(b"samples:"))
    return hashlib.sha256(kept).hexdigest()


def seal_of(manifest: dict[str, Any]) -> str:
    """Return the SHA-256 over a manifest's content, its own seal left out."""
    rest = {key: value for key, value in manifest.items() if key != SEAL}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def damaged_files(corpus: Path, manifest: dict[str, Any]) -> list[str]:
    """Name every file whose content differs from what the manifest recorded.

    Parameters
    ----------
    corpus : Path
    manifest : dict
        As read; what an older one did not record is not judged.

    Returns
    -------
    list of str
        One sentence per file.
    """
    found = []
    for name, good in _judged(corpus, manifest):
        if not good:
            found.append(
                f"{corpus / name}: its content differs from what MANIFEST.json recorded; where a "
                "run was interrupted, `synthgen generate` with the same arguments finishes it"
            )
    return found


def _judged(corpus: Path, manifest: dict[str, Any]) -> Iterator[tuple[str, bool]]:
    for name, known in manifest.get("files", {}).items():
        yield name, _is(corpus / name, known)
    plan = manifest.get("plan_bytes")
    yield "plan.jsonl", plan is None or _is(corpus / "plan.jsonl", manifest["plan_sha256"], plan)
    yield "engine.json", _same_engine(corpus / "engine.json", manifest)
    known = manifest.get("config_sha256")
    yield CONFIG, known is None or config_sha256(corpus / CONFIG) == known


def _is(path: Path, known: str, first: int | None = None) -> bool:
    try:
        return file_sha256(path, first) == known
    except OSError:
        return False


def _same_engine(path: Path, manifest: dict[str, Any]) -> bool:
    try:
        content = json.loads(path.read_bytes())
        return all(manifest.get(key) == value for key, value in content.items())
    except (OSError, ValueError, AttributeError):
        return False
