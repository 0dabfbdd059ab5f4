"""What each quality costs: CPU seconds per written sample, all labels, after the first ones."""

from __future__ import annotations

import statistics
import time
from typing import Any

from threadpoolctl import threadpool_limits

WARM, ROUNDS = 10, 8
# One structure: the kernels that its first samples compile are all that it may need.
ROOM = ["background.room=1000", "light.room=1000", "model.hands=right"]
CASES: dict[str, tuple[str, list[str]]] = {
    "plain, 256, 16 spp": ("hand_rgbd", []),
    "full, 256, 8 spp": ("hand_full", []),
    "full, room, 256, 8 spp": ("hand_full", ROOM),
    "full, room, 448, 20 spp": (
        "hand_full", [*ROOM, "render.width=448", "render.height=448", "render.spp=20"]
    ),
}  # fmt: skip


def run() -> dict[str, Any]:
    """Time drawing, rendering and encoding of samples, and count kernels compiled meanwhile."""
    with threadpool_limits(limits=1):
        rows = [[name, *_case(*case)] for name, case in CASES.items()]
    return {
        "title": f"CPU seconds per sample, {ROUNDS} samples after {WARM}",
        "columns": ["quality", "median", "mean", "new kernels"],
        "rows": rows,
    }


def _case(preset: str, settings: list[str]) -> tuple[float, float, int]:
    from synthgen.config import load_config
    from synthgen.corpus.columns import encode_view
    from synthgen.render import backend
    from synthgen.render.renderer import Renderer
    from synthgen.sampling.draw import draw_sample

    config = load_config(preset, settings)
    renderer = Renderer(config.render.variant)
    dr = backend.drjit()
    times, compiled, known = [], 0, set()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for index in range(WARM + ROUNDS):
            dr.kernel_history_clear()
            begun = time.process_time()
            spec = draw_sample(config, index)
            for number, view in enumerate(renderer.attempt(spec)[1]):
                encode_view(spec, number, view, config.corpus.columns, config.corpus.jpeg_quality)
            times.append(time.process_time() - begun)
            # By hash: what an earlier process left on the disk counts as well.
            used = {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}
            compiled += len(used - known) if index >= WARM else 0
            known |= used
    late = times[WARM:]
    return round(statistics.median(late), 3), round(statistics.fmean(late), 3), compiled
