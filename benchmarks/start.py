"""Start-up: CPU seconds of importing synthgen and of the command line, beside what they rest on."""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
from typing import Any

REPEATS = 5
WORK = {
    "python itself": "pass",
    "import synthgen": "import synthgen",
    "import numpy": "import numpy",
    "import typer": "import typer",
    "import pydantic": "import pydantic",
    "synthgen --version": "from synthgen.cli.main import main; main(['--version'])",
    "load cc0-hand": "import synthgen; synthgen.models.load('cc0-hand')",
    "load hand_rgbd": "import synthgen; synthgen.config.load_config('hand_rgbd')",
    "import mitsuba": "import mitsuba",
    "import torch": "import torch",
}


def run() -> dict[str, Any]:
    """Time each line in fresh interpreters."""
    rows = [[name, *_seconds(code)] for name, code in WORK.items()]
    return {
        "title": f"Start-up, CPU seconds of a fresh interpreter, {REPEATS} runs",
        "columns": ["what", "median", "lowest", "highest"],
        "rows": rows,
    }


def _seconds(code: str) -> tuple[float, float, float]:
    times = [_one(code) for _ in range(REPEATS)]
    return statistics.median(times), min(times), max(times)


def _one(code: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
