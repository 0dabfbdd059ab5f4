"""Keyed random streams: nothing depends on worker, order, time or shard count.

A stream is named by (corpus seed, kind, id, attempt, name). Subject streams are keyed by the
subject's id, sample streams by the sample's index, so that adding or switching one ingredient
leaves every other one as it was.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Literal

import numpy as np

from synthgen.errors import ShapeError

Kind = Literal["corpus", "subject", "sample", "scanner"]
# One sample's streams by name.
Streams = Callable[[str], np.random.Generator]


def stream(seed: int, kind: Kind, ident: int, attempt: int, name: str) -> np.random.Generator:
    """Return the generator of one stream.

    Parameters
    ----------
    seed : int
        Corpus seed, >= 0; seed 0 is a seed like any other.
    kind : {"corpus", "subject", "sample", "scanner"}
        What ``ident`` counts.
    ident : int
        Subject id or sample index, >= 0.
    attempt : int
        0, or higher for a sample that is redrawn; >= 0.
    name : str
        Ingredient, for example ``"pose"`` or ``"light"``.

    Returns
    -------
    numpy.random.Generator
        Philox4x64, keyed by the first 128 bits of SHA-256 over the five parts.

    Raises
    ------
    ShapeError
        If a number is negative or no integer.
    """
    if not all(isinstance(n, int | np.integer) and n >= 0 for n in (seed, ident, attempt)):
        raise ShapeError(
            f"stream key (seed={seed!r}, id={ident!r}, attempt={attempt!r}); use integers >= 0"
        )
    text = f"synthgen/1/{seed}/{kind}/{ident}/{attempt}/{name}"
    words = np.frombuffer(hashlib.sha256(text.encode()).digest()[:16], dtype="<u8")
    return np.random.Generator(np.random.Philox(key=words))
