"""The plan: one fully resolved row per sample, written before anything is rendered.

Rows are appended to a part file that a later run continues, and put in their place when all are
there; a million rows never lie in memory.
"""

from __future__ import annotations

import fcntl
import json
import multiprocessing
import shutil
import signal
from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress
from threadpoolctl import threadpool_limits

from synthgen.config import Config, config_hash, load_config, resolved_yaml
from synthgen.corpus import atomic
from synthgen.corpus.checksums import CONFIG
from synthgen.corpus.manifest import engine
from synthgen.corpus.threads import single_threaded_children
from synthgen.errors import CorpusError, SynthgenError
from synthgen.sampling.draw import draw_sample
from synthgen.sampling.spec import SampleSpec

PLAN = "plan.jsonl"
PART = ".plan.jsonl.part"
ENGINE = "engine.json"
CLAIMS = "claims"
# Rows drawn at a time by a worker, and the fewest rows for which starting workers pays.
CHUNK, WORTH_WORKERS = 32, 1000
_SCAN_BYTES = 2**24


def write_plan(config: Config, out: Path, *, workers: int = 1, progress: bool = True) -> Path:
    """Resolve every sample and write the plan; an existing one is kept and lengthened.

    Parameters
    ----------
    config : Config
    out : Path
        The corpus folder.
    workers : int
        Processes that draw; the rows are the same for any number.
    progress : bool
        Show a progress bar on a terminal.

    Returns
    -------
    Path
        ``out/plan.jsonl``.

    Raises
    ------
    CorpusError
        If the folder holds a corpus of another config, back end, model or library version, or
        cannot be written. What was drawn before an interrupt or a full disk is kept.
    """
    mine = {"config_hash": config_hash(config), **engine(config)}
    atomic.make_folder(out)
    _refuse_strangers(out)
    atomic.make_folder(out / CLAIMS)
    with open(out / CLAIMS / "plan", "w") as claim:
        fcntl.flock(claim, fcntl.LOCK_EX)  # another machine may be planning the same folder
        _claim(config, mine, out)
        if count_rows(out) < config.samples:
            _extend(config, out, workers, progress)
    return out / PLAN


def count_rows(out: Path) -> int:
    """Return how many samples are planned in a corpus folder."""
    return len(_row_starts(out / PLAN)) - 1


def _extend(config: Config, out: Path, workers: int, progress: bool) -> None:
    part = out / PART
    first = _begin_part(out)
    rows = _drawn_rows(config, first, workers)
    console = Console(stderr=True)  # stdout belongs to the verb's own words
    shown = progress and console.is_terminal
    with Progress(console=console, transient=True, disable=not shown) as bar:
        task = bar.add_task("planning", total=config.samples, completed=first)
        with atomic.explained(part), open(part, "ab") as file:
            for row in rows:
                file.write(row)
                bar.advance(task)
    atomic.put_in_place(part, out / PLAN)


def _begin_part(out: Path) -> int:
    """Make the part file hold whole rows only, at least those of the plan; return how many."""
    plan, part = out / PLAN, out / PART
    with atomic.explained(part):
        if len(_row_starts(part)) <= len(_row_starts(plan)):
            shutil.copyfile(plan, part) if plan.is_file() else part.write_bytes(b"")
        starts = _row_starts(part)
        with open(part, "r+b") as file:
            file.truncate(int(starts[-1]))
    return len(starts) - 1


def _drawn_rows(config: Config, first: int, workers: int) -> Iterator[bytes]:
    if workers == 1 or config.samples - first < WORTH_WORKERS:
        with threadpool_limits(limits=1):
            yield from (_row(config, index) for index in range(first, config.samples))
        return
    chunks = [range(a, min(a + CHUNK, config.samples)) for a in range(first, config.samples, CHUNK)]
    context = multiprocessing.get_context("spawn")
    with single_threaded_children(), context.Pool(workers, _leave_interrupts) as pool:
        for rows in pool.imap(partial(_rows, config), chunks):
            yield from rows


def _leave_interrupts() -> None:
    """Let the parent alone answer an interrupt; it ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _rows(config: Config, indices: range) -> list[bytes]:
    return [_row(config, index) for index in indices]


def _row(config: Config, index: int) -> bytes:
    row = draw_sample(config, index).to_json()
    return json.dumps(row, sort_keys=True, separators=(",", ":")).encode() + b"\n"


def _refuse_strangers(out: Path) -> None:
    """Refuse a folder that holds something else, before anything is written into it."""
    there = {found.name for found in out.iterdir() if not found.name.startswith(".")}
    if there - {CLAIMS} and ENGINE not in there:
        raise CorpusError(f"{out} is not empty and holds no corpus; choose another --out")


def _other_keys(config: Config, out: Path) -> str:
    """Say which keys of the folder's configuration are others; "" where that cannot be told."""
    try:
        stored = _flat(load_config(str(out / CONFIG)).model_dump(mode="json"))
    except (SynthgenError, OSError):
        return ""
    mine = _flat(config.model_dump(mode="json"))
    return "; ".join(f"{key} was {stored.get(key)}, is {mine.get(key)}" for key in sorted(mine)
                     if key != "samples" and stored.get(key) != mine.get(key))  # fmt: skip


def _flat(content: dict[str, Any], before: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in content.items():
        inner = isinstance(value, dict)
        found |= _flat(value, f"{before}{key}.") if inner else {before + key: value}
    return found


def _claim(config: Config, mine: dict[str, Any], out: Path) -> None:
    """Refuse a folder that belongs to another config or was made by another engine."""
    path = out / ENGINE
    if path.is_file():
        theirs = _read_json(path)
        differing = [k for k in mine if theirs.get(k) != mine[k]]
        if differing:
            said = "; ".join(
                (k == "config_hash" and _other_keys(config, out))
                or f"{k} was {theirs.get(k)}, is {mine[k]}"
                for k in differing
            )
            raise CorpusError(
                f"{out} holds a corpus of another making ({said}); choose another --out, or "
                "restore what it was made with"
            )
    else:
        # rows of another config: who empties a folder by its visible files leaves them behind
        (out / PART).unlink(missing_ok=True)
        atomic.replace(path, json.dumps(mine, sort_keys=True, indent=1).encode())
    atomic.replace(out / CONFIG, resolved_yaml(config).encode())


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise CorpusError(f"{path}: unreadable ({error})") from None
    return content if isinstance(content, dict) else {}


def read_plan(out: Path, first: int = 0, stop: int | None = None) -> list[SampleSpec]:
    """Read rows ``first`` to ``stop`` (excluded) of the plan; the others are not touched.

    Raises
    ------
    CorpusError
        If the plan is missing, or a row is damaged (the row is named).
    """
    path = out / PLAN
    if not path.is_file():
        raise CorpusError(f"{path} is missing; is {out} a corpus?")
    starts = _row_starts(path)
    last = len(starts) - 1 if stop is None else min(stop, len(starts) - 1)
    if first >= last:
        return []
    with open(path, "rb") as file:
        file.seek(int(starts[first]))
        rows = file.read(int(starts[last] - starts[first])).splitlines()
    specs = []
    for number, row in enumerate(rows, start=first):
        try:
            specs.append(SampleSpec.from_json(json.loads(row)))
        except (ValueError, KeyError, TypeError) as error:
            raise CorpusError(f"{path}: row {number} is damaged ({error})") from None
    return specs


def _row_starts(path: Path) -> NDArray[np.int64]:
    """Return where rows begin, and last where the whole rows end: (rows + 1,); [0] for no file."""
    if not path.is_file():
        return np.zeros(1, dtype=np.int64)
    state = path.stat()
    return _scan(str(path), state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=4)
def _scan(path: str, size: int, stamp: int) -> NDArray[np.int64]:
    starts, at = [np.zeros(1, dtype=np.int64)], 0
    with open(path, "rb") as file:
        while block := file.read(_SCAN_BYTES):
            ends = np.flatnonzero(np.frombuffer(block, dtype=np.uint8) == ord("\n"))
            starts.append(ends + (at + 1))
            at += len(block)
    return np.concatenate(starts)
