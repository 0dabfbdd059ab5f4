"""Self-test of the hand5 scanner: T1-T9 and what a scan costs, each beside its target.

Rows: planes, noise, spheres, spacing, step_edge, webbing, hand, motion, green, cost. The error
budget over scanners is ``synthgen bench scanner_budget``, levels against each other are
``synthgen bench scanner_noise``. About seven CPU minutes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from benchmarks.scanner_parts import hands, pairs
from benchmarks.scanner_parts.rows import run_tests

TESTS = {
    "planes": pairs.planes,
    "noise": pairs.noise,
    "spheres": pairs.spheres,
    "spacing": hands.spacing,
    "step_edge": pairs.step_edge,
    "webbing": pairs.webbing,
    "hand": hands.hand,
    "motion": pairs.motion,
    "green": hands.green,
    "cost": hands.cost,
}


def run(rows: Sequence[str] = (), pictures: Path = Path("out/scanner")) -> dict[str, Any]:
    """Run the tests that are named, or all; millimetres unless a row says otherwise."""
    title = "hand5 scanner; millimetres unless said, exact calibration unless said"
    with threadpool_limits(limits=1):
        return run_tests(TESTS, rows, pictures, title)
