"""Memory of one worker over many samples: the last third beside the first."""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

SAMPLES = 300


def run() -> dict[str, Any]:
    """Render samples in this process, read its resident size after each."""
    from synthgen.config import load_config
    from synthgen.corpus.runner import generate, render_attempts

    resident: list[int] = []

    def watched(config: Any) -> Any:
        attempt = render_attempts(config)

        def once(spec: Any) -> Any:
            resident.append(_resident_kib())
            return attempt(spec)

        return once

    config = load_config("hand_rgbd", [f"samples={SAMPLES}", "render.spp=4"])
    with tempfile.TemporaryDirectory() as folder:
        generate(config, Path(folder) / "corpus", maker=watched, progress=False)
    third = len(resident) // 3
    parts = [statistics.median(resident[k * third : (k + 1) * third]) / 1024 for k in range(3)]
    return {
        "title": f"resident MiB of one worker, {SAMPLES} samples of hand_rgbd at 4 spp",
        "columns": ["third", "median MiB"],
        "rows": [[name, mib] for name, mib in zip(("first", "second", "last"), parts, strict=True)],
        "notes": [f"last / first: {parts[2] / parts[0]:.4f}"],
    }


def _resident_kib() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1])
    raise OSError("/proc/self/status has no VmRSS")
