"""What a verb hands back, and how it is printed."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import typer

DONE, FAILED, WRONG, WORK_LEFT = 0, 1, 2, 3


@dataclass(frozen=True)
class Result:
    """Outcome of a verb.

    Attributes
    ----------
    payload : dict
        JSON types; printed by ``--json``.
    lines : sequence of str
        The same for people.
    code : int
        Exit code: 0 done, 1 a check failed, 2 wrong use or bad input, 3 work left.
    """

    payload: dict[str, Any]
    lines: Sequence[str] = field(default=())
    code: int = DONE

    def emit(self, as_json: bool) -> int:
        """Print to stdout and return the exit code."""
        if as_json:
            told = json.dumps(finite(self.payload), ensure_ascii=False, allow_nan=False)
            typer.echo(printable(told))
        else:
            for line in self.lines:
                typer.echo(printable(line))
        return self.code


def printable(text: str) -> str:
    """Return text that UTF-8 has; other bytes of file names are told as Python tells them."""
    return text.encode("utf-8", "backslashreplace").decode()


def finite(value: Any) -> Any:
    """Return the same with null for NaN and infinity, which JSON lacks."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextlib.contextmanager
def stdout_kept_clean(wanted: bool) -> Iterator[None]:
    """Send to stderr whatever libraries print, native ones included, so that JSON stands alone."""
    if not wanted:
        yield
        return
    sys.stdout.flush()
    saved = os.dup(1)
    try:
        os.dup2(2, 1)
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)


def columns(rows: Sequence[Sequence[object]]) -> list[str]:
    """Lay out rows of equal length in aligned columns."""
    words = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*words, strict=True)]
    return [
        "  ".join(w.ljust(n) for w, n in zip(row, widths, strict=True)).rstrip() for row in words
    ]
