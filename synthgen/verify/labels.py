"""Verifying the labels of a corpus."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from synthgen.corpus import Corpus, open_corpus, shards
from synthgen.corpus.checksums import damaged_files
from synthgen.corpus.plan import count_rows
from synthgen.errors import IntegrityError
from synthgen.scanner import Rig
from synthgen.verify.checks import check_view
from synthgen.verify.report import UNREADABLE, Failure, VerifyReport
from synthgen.verify.scans import check_scan
from synthgen.verify.stereo import check_stereo, rig_of


def verify(path: str | Path, samples: int | None = None, *, progress: bool = False) -> VerifyReport:
    """Recompute every label that the stored truth determines and compare.

    Parameters
    ----------
    path : str or Path
        A finished corpus.
    samples : int or None
        Check this many, spread evenly; None checks all. Checksums are always all checked.
    progress : bool
        Show a progress bar on a terminal.

    Returns
    -------
    VerifyReport
        ``.ok``, ``.failures`` naming sample, view, check, value and limit.

    Raises
    ------
    CorpusError
        If the folder holds no corpus at all.
    """
    report = VerifyReport()
    corpus = open_corpus(path)
    for shard in corpus.shard_numbers:
        try:
            shards.check_hashes(corpus.path, shard, corpus.sidecar_sha256[shard])
        except IntegrityError as error:
            report.failures.append(Failure(-1, -1, "checksum", 1.0, 0.0, str(error)))
    for words in damaged_files(corpus.path, corpus.manifest):
        report.failures.append(Failure(-1, -1, "checksum", 1.0, 0.0, words))
    report.planned, report.there = count_rows(corpus.path), len(corpus)
    rig = rig_of(corpus)
    chosen = _spread(len(corpus), samples)
    console = Console(stderr=True)
    with Progress(console=console, disable=not (progress and console.is_terminal)) as bar:
        for position in bar.track(chosen, description="verifying"):
            _one(report, corpus, position, rig)
    report.samples = len(chosen)
    return report


def _one(report: VerifyReport, corpus: Corpus, position: int, rig: Rig | str) -> None:
    try:
        sample = corpus[position]
        with np.errstate(all="ignore"):  # damaged labels make NaNs, which fail what they meet
            for view in sample.views:
                check_view(report, sample, view)
                report.views += 1
            check_scan(report, sample)
            check_stereo(report, rig, sample)
    except UNREADABLE as error:
        message = f"{type(error).__name__}: {error}"
        number = corpus.index_of(position)
        report.failures.append(Failure(number, -1, "readable", 1.0, 0.0, message))


def _spread(n: int, wanted: int | None) -> list[int]:
    if wanted is None or wanted >= n:
        return list(range(n))
    return sorted({k * n // max(wanted, 1) for k in range(wanted)})
