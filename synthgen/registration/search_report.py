"""What the search that led to a hand's fit says of itself, as JSON types."""

from __future__ import annotations

from typing import Any

import numpy as np

from synthgen.registration.advice import advice
from synthgen.registration.fitted import Side
from synthgen.registration.search import Candidate, Search
from synthgen.registration.verdict import Judgement


def report_of(
    search: Search,
    judgement: Judgement,
    chosen: Candidate,
    *,
    hand: Side,
    start: str,
    dropped: int,
    cpu_s: float,
) -> dict[str, Any]:
    """Return the report of a fit: verdict and advice, what was tried, stages, statistics, seconds.

    ``dropped`` points were not finite; ``start`` is said in words.
    """
    found, settings = chosen.statistics, search.settings
    message = advice(judgement, found, hand)
    return {
        "verdict": judgement.verdict,
        "reason": judgement.text,
        **({} if message is None else {"message": message}),
        "hand": hand,
        "model": settings.model.name,
        "model_digest": settings.model.digest,
        "preset": settings.preset.name,
        "curved": settings.curved,
        "start": start,
        "points": len(search.scan.points),
        "points_dropped": dropped,
        "candidates": [_tried(candidate) for candidate in search.candidates],
        "stages": chosen.stages,
        "largest_beta": float(np.abs(chosen.x[settings.surface.shape]).max(initial=0.0)),
        "statistics": None if found is None else found.to_json(),
        "cpu_s": {"total": cpu_s, **search.seconds},
    }


def _tried(candidate: Candidate) -> dict[str, Any]:
    judgement = candidate.judgement
    return {
        "source": candidate.source,
        "early_explained": candidate.early,
        "verdict": None if judgement is None else judgement.verdict,
        "reason": "dropped early" if judgement is None else judgement.text,
    }
