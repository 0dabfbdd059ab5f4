"""Cost of a sample: CPU seconds of whole commands, one worker and two, fixed cost told apart."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

FEW, MANY = 4, 36
# Constant and area light, 256x256, 16 spp: what a prototype did in 0.79 CPU s, a quarter of what
# Blender Cycles took for the same work on that machine.
REFERENCE_S = 0.79
SETTINGS = ("light.room=0", "background.room=0", "corpus.shard_size=2")


def run() -> dict[str, Any]:
    """Generate small and larger corpora; their difference is the cost after warm-up."""
    rows = [_row(workers) for workers in (1, 2)]
    one, two = rows[0][3], rows[1][3]
    rows.append(["prototype, 1 worker", "", "", REFERENCE_S])
    return {
        "title": "hand_rgbd, 256x256, 16 spp, constant or area light, every label, written",
        "columns": ["what", f"CPU s, {FEW} samples", f"CPU s, {MANY} samples", "CPU s per sample"],
        "rows": rows,
        "notes": [f"two workers / one: {two / one:.2f}"],
    }


def _row(workers: int) -> list[Any]:
    few, many = (_seconds(samples, workers) for samples in (FEW, MANY))
    return [f"{workers} worker{'s' * (workers > 1)}", few, many, (many - few) / (MANY - FEW)]


def _seconds(samples: int, workers: int) -> float:
    """CPU seconds of one `synthgen generate`, its workers included."""
    with tempfile.TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "synthgen", "generate", "hand_rgbd", "--json",
                   "--out", str(Path(folder) / "corpus"), "--samples", str(samples),
                   "--workers", str(workers)]  # fmt: skip
        for setting in SETTINGS:
            command += ["--set", setting]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert json.loads(done.stdout)["samples"] == samples
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
