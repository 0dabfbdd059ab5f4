"""Cost of a sample: CPU seconds of whole commands, one worker and two, fixed cost told apart."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

# Samples per worker: every worker has warmed up its own scenes after the few.
FEW, MANY = 12, 60
# Constant and area light, 256x256, 16 spp, nothing behind the hand: what a prototype did in
# 0.79 CPU s, a quarter of what Blender Cycles took for the same work on that machine.
REFERENCE_S = 0.79
ALWAYS = ("light.room=0", "background.room=0", "corpus.shard_size=2")
BEHIND = {
    "nothing": ("background.plain=0", "background.procedural=0", "background.empty=1"),
    "walls": (),
}


def run() -> dict[str, Any]:
    """Generate small and larger corpora; their difference is the cost after warm-up."""
    rows = [_row(behind, workers) for behind in BEHIND for workers in (1, 2)]
    ratios = [f"{two[0]}: {two[4] / one[4]:.2f}" for one, two in zip(rows[::2], rows[1::2],
              strict=True)]  # fmt: skip
    rows.append(["nothing", "prototype, 1", "", "", REFERENCE_S])
    return {
        "title": "hand_rgbd, 256x256, 16 spp, constant or area light, every label, written",
        "columns": ["behind the hand", "workers", f"CPU s, {FEW} samples each",
                    f"CPU s, {MANY} samples each", "CPU s per sample"],
        "rows": rows,
        "notes": [f"two workers / one, {', '.join(ratios)}"],
    }  # fmt: skip


def _row(behind: str, workers: int) -> list[Any]:
    few, many = (_seconds(BEHIND[behind], n * workers, workers) for n in (FEW, MANY))
    return [behind, workers, few, many, (many - few) / (MANY - FEW) / workers]


def _seconds(settings: tuple[str, ...], samples: int, workers: int) -> float:
    """CPU seconds of one `synthgen generate`, its workers included."""
    with tempfile.TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "synthgen", "generate", "hand_rgbd", "--json",
                   "--out", str(Path(folder) / "corpus"), "--samples", str(samples),
                   "--workers", str(workers)]  # fmt: skip
        for setting in (*ALWAYS, *settings):
            command += ["--set", setting]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert json.loads(done.stdout)["samples"] == samples
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
