"""Making a corpus: single-threaded worker processes, one shard at a time, resumable.

Unit of work is the shard, a pure function of the plan. A worker claims it by a file lock that the
kernel drops at any death, and commits it whole; the same command makes whatever is missing.
"""

from __future__ import annotations

import fcntl
import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from synthgen.config import Config
from synthgen.corpus import atomic, shards
from synthgen.corpus.columns import encode_view, key_of
from synthgen.corpus.manifest import write_manifest
from synthgen.corpus.plan import CLAIMS, read_plan, write_plan
from synthgen.corpus.threads import single_threaded_children
from synthgen.errors import CorpusError, SynthgenError, WorkLeft
from synthgen.render.renderer import RenderedView
from synthgen.sampling.spec import SampleSpec

MAX_ATTEMPTS = 10
MAX_DEATHS = 3
# Makes one attempt at a sample: why it must be drawn again, or None and its views.
Attempt = Callable[[SampleSpec], tuple[str | None, list[RenderedView]]]
Maker = Callable[[Config], Attempt]
Tell = Callable[[int, int], None]  # of a shard, how many more samples are rendered; 0: committed


@dataclass(frozen=True)
class Summary:
    """What a run did, of a folder that others may fill, too.

    ``samples``, ``redrawn`` and ``bytes`` are those of the folder; ``shards_made`` this run's own,
    ``shards_present`` were there before or came from other runs meanwhile, ``shards_elsewhere``
    were asked for and are still in another run's hands.
    """

    out: str
    samples: int
    shards_made: int
    shards_present: int
    shards_elsewhere: int
    redrawn: int
    bytes: int
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return the summary as JSON types."""
        return asdict(self)


def render_attempts(config: Config) -> Attempt:
    """Return the real maker: a renderer that persists for the life of the worker."""
    from synthgen.render.renderer import Renderer

    return with_sensors(config, Renderer(config.render.variant).attempt)


def with_sensors(config: Config, attempt: Attempt) -> Attempt:
    """Return a maker that adds scan and sensor depth, where asked for, to another's views."""
    if config.scanner.rig is not None:
        from synthgen.corpus.scanning import Scanning

        attempt = Scanning(config, attempt).attempt
    if config.render.sensor_depth != "off":
        from synthgen.corpus.sensing import DepthSensing

        attempt = DepthSensing(config, attempt).attempt
    return attempt


def generate(
    config: Config,
    out: Path,
    *,
    workers: int = 1,
    shards_range: tuple[int, int] | None = None,
    progress: bool = True,
    maker: Maker = render_attempts,
) -> Summary:
    """Plan, render and store a corpus; resumes what is there.

    Parameters
    ----------
    config : Config
    out : Path
        The corpus folder; created, or one that the same config began.
    workers : int
        Processes, each on one thread.
    shards_range : (first, stop) or None
        Make only these shards (for clusters), and leave all others as they are; the manifest
        covers what is there.
    progress : bool
        Show a progress bar on a terminal.
    maker : callable
        Makes the function that renders; replaced in tests.

    Raises
    ------
    CorpusError
        If the folder is of another making, cannot be written, holds none of the shards that are
        asked for, or a shard keeps killing workers.
    WorkLeft
        If the run was interrupted; the same command resumes.
    """
    if workers < 1:
        raise CorpusError(f"workers={workers}; at least 1")
    begun = time.monotonic()
    try:
        write_plan(config, out, workers=workers, progress=progress)
        todo = _todo(config, out, shards_range)
        made: list[int] = []
        with _bar(progress, config, todo, made) as tell:
            if workers == 1:
                _work(config, out, todo, maker, tell)
            else:
                _supervise(config, out, todo, workers, maker, tell)
    except KeyboardInterrupt:
        raise WorkLeft(f"interrupted; run the same command to finish {out}") from None
    with open(out / CLAIMS / "manifest", "w") as claim:
        fcntl.flock(claim, fcntl.LOCK_EX)  # the last to write has seen what all others committed
        write_manifest(out)
    return _summary(out, todo, made, time.monotonic() - begun)


def _summary(out: Path, todo: list[int], made: list[int], seconds: float) -> Summary:
    done = shards.done_shards(out)
    samples = redrawn = size = 0
    for sidecar in (shards.read_sidecar(out, k) for k in done):
        samples += len(sidecar["samples"])
        redrawn += len(sidecar["redrawn"])
        size += sum(facts["bytes"] for facts in sidecar["columns"].values())
    return Summary(
        out=str(out),
        samples=samples,
        shards_made=len(made),
        shards_present=len(set(done) - set(made)),
        shards_elsewhere=len(set(todo) - set(done)),
        redrawn=redrawn,
        bytes=size,
        seconds=round(seconds, 3),
    )


def _todo(config: Config, out: Path, wanted: tuple[int, int] | None) -> list[int]:
    """Shards to make; of those asked for, one that fewer samples cut short is made again."""
    for folder in (shards.SIDECARS, CLAIMS, *config.corpus.columns):
        atomic.make_folder(out / folder)
    size, total = config.corpus.shard_size, -(-config.samples // config.corpus.shard_size)
    first, stop = wanted or (0, total)
    if not 0 <= first < min(stop, total):
        raise CorpusError(
            f"shards {first}:{stop} holds none of the {total} shards 0:{total} of {config.samples} "
            f"samples (corpus.shard_size={size})"
        )
    asked = range(first, min(stop, total))
    for k in shards.done_shards(out):
        whole = min(size, config.samples - k * size)
        if k in asked and len(shards.read_sidecar(out, k)["samples"]) < whole:
            shards.drop_shard(out, k)
    done = set(shards.done_shards(out))
    return [k for k in asked if k not in done]


@contextmanager
def _bar(progress: bool, config: Config, todo: list[int], made: list[int]) -> Iterator[Tell]:
    """Show how many samples are rendered; shards that are told of are added to ``made``."""
    size = config.corpus.shard_size
    samples = sum(min(size, config.samples - k * size) for k in todo)
    console = Console(stderr=True)
    columns = (TextColumn("rendering"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not (progress and console.is_terminal)) as bar:
        task = bar.add_task("samples", total=samples)

        def tell(shard: int, samples: int) -> None:
            bar.advance(task, samples)
            if not samples:
                made.append(shard)

        yield tell


def _work(config: Config, out: Path, todo: list[int], maker: Maker, tell: Tell) -> None:
    if not todo:
        return
    with threadpool_limits(limits=1):
        attempt = maker(config)
        for shard in todo:
            make_shard(config, out, shard, attempt, tell)


def make_shard(config: Config, out: Path, shard: int, attempt: Attempt, tell: Tell) -> None:
    """Make and commit one shard, unless another process holds or has made it."""
    with open(out / CLAIMS / f"{shard:06d}", "w") as claim:
        try:
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return
        if shards.sidecar_path(out, shard).exists():
            return
        first = shard * config.corpus.shard_size
        stop = min(first + config.corpus.shard_size, config.samples)
        redrawn: dict[str, list[str]] = {}
        with shards.ShardWriter(out, shard, config.corpus.columns) as writer:
            for spec in read_plan(out, first, stop):
                made, views, reasons = _accepted(config, spec, attempt)
                if reasons:
                    redrawn[str(spec.index)] = reasons
                _write(config, made, views, writer)
                tell(shard, 1)
            writer.commit({"samples": list(range(first, stop)), "redrawn": redrawn})
        tell(shard, 0)


def _accepted(
    config: Config, spec: SampleSpec, attempt: Attempt
) -> tuple[SampleSpec, list[RenderedView], list[str]]:
    """Try the planned sample, then redraws of it, until one is not rejected."""
    from synthgen.sampling.draw import draw_sample

    reasons: list[str] = []
    for number in range(MAX_ATTEMPTS):
        tried = spec if number == 0 else draw_sample(config, spec.index, attempt=number)
        reason, views = attempt(tried)
        if reason is None:
            return tried, views, reasons
        reasons.append(reason)
    scanned = f"the rig (see `synthgen doctor rig {config.scanner.rig}`)"
    cause = scanned if reasons[-1].startswith("scan: ") else "camera.fill, orientation"
    raise CorpusError(
        f"sample {spec.index} was rejected {MAX_ATTEMPTS} times, at last because {reasons[-1]}; "
        f"change the configuration: {cause}"
    )


def _write(
    config: Config, spec: SampleSpec, views: list[RenderedView], writer: shards.ShardWriter
) -> None:
    for number, view in enumerate(views):
        encoded = encode_view(spec, number, view, config.corpus.columns, config.corpus.jpeg_quality)
        key = key_of(spec.index, number)
        for column, members in encoded.items():
            writer.add(column, {f"{key}.{s}": data for s, data in members.items()})


def _supervise(
    config: Config, out: Path, todo: list[int], workers: int, maker: Maker, tell: Tell
) -> None:
    """Run workers until every shard is committed; replace those that die."""
    context = multiprocessing.get_context("spawn")
    results: Any = context.Queue()
    with single_threaded_children():
        running = [_start(context, config, out, todo, w, workers, maker, results)
                   for w in range(min(workers, max(len(todo), 1)))]  # fmt: skip
        deaths, message = 0, ""
        try:
            while any(p.exitcode not in (0, 2) for p in running):
                message = _drain(results, tell) or message
                for number, process in enumerate(running):
                    if process.exitcode not in (None, 0, 2):
                        deaths += 1
                        _refuse_endless(deaths, process.exitcode, out)
                        running[number] = _start(
                            context, config, out, todo, number, workers, maker, results
                        )
                time.sleep(0.05)
        finally:
            for process in running:
                process.terminate() if process.is_alive() else None
                process.join()
    message = _drain(results, tell) or message
    if message:
        raise CorpusError(message)


def _refuse_endless(deaths: int, code: int | None, out: Path) -> None:
    if deaths > MAX_DEATHS:
        raise CorpusError(
            f"workers died {deaths} times (last exit code {code}); {out} keeps what is committed. "
            "Check memory, then run the same command again"
        )


def _start(
    context: Any, config: Config, out: Path, todo: list[int], number: int, workers: int,
    maker: Maker, results: Any,
) -> Any:  # fmt: skip
    turned = todo[number * len(todo) // workers :] + todo[: number * len(todo) // workers]
    arguments = (config, out, turned, maker, results)
    process = context.Process(target=_worker, args=arguments, daemon=True)
    process.start()
    return process


def _worker(config: Config, out: Path, todo: list[int], maker: Maker, results: Any) -> None:
    try:
        _work(config, out, todo, maker, lambda shard, samples: results.put((shard, samples)))
    except KeyboardInterrupt:
        raise SystemExit(0) from None
    except SynthgenError as error:
        results.put(str(error))
        raise SystemExit(2) from None


def _drain(results: Any, tell: Tell) -> str:
    """Pass on what workers report; return a worker's error message, or nothing."""
    message = ""
    while not results.empty():
        said = results.get()
        if isinstance(said, str):
            message = said
        else:
            tell(*said)
    return message
