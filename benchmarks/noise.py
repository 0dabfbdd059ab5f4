"""Noise at equal time: light paths per pixel, raw and denoised, against plain path tracing.

Root mean square error of the logarithm of radiance, over rooms, against many paths per pixel.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

SCENES, REFERENCE_SPP = (1, 2, 5), 512
COUNTS = (4, 8, 16, 32, 64)
SETTINGS = ["background.room=1000", "light.room=1000", "optics.motion=0", "optics.defocus=0",
            "render.diffusion=false", "render.denoise=oidn", "model.hands=right",
            "render.width=192", "render.height=192"]  # fmt: skip


def run() -> dict[str, Any]:
    """Render each scene at every count, raw and denoised, and compare with the reference."""
    from synthgen.config import load_config
    from synthgen.render.renderer import Renderer
    from synthgen.sampling.draw import draw_sample

    config = load_config("hand_full", SETTINGS)
    renderer = Renderer(config.render.variant)
    found: dict[tuple[int, str], list[tuple[float, float]]] = {}
    with threadpool_limits(limits=1):
        for index in SCENES:
            spec = draw_sample(config, index)
            truth, _ = _timed(renderer, spec, REFERENCE_SPP, "none")
            for kind in ("none", "oidn"):
                _timed(renderer, spec, 4, kind)  # kernels
                for spp in COUNTS:
                    image, seconds = _timed(renderer, spec, spp, kind)
                    found.setdefault((spp, kind), []).append((_error(image, truth), seconds))
    rows = [
        [spp, {"none": "raw", "oidn": "denoised"}[kind],
         *np.mean(found[spp, kind], axis=0).round(4).tolist()]
        for kind in ("none", "oidn") for spp in COUNTS
    ]  # fmt: skip
    return {
        "title": f"192x192 rooms, {len(SCENES)} scenes, against {REFERENCE_SPP} paths per pixel",
        "columns": ["paths per pixel", "picture", "RMSE of log radiance", "CPU s"],
        "rows": rows,
        "notes": [_verdict({(r[0], r[1]): (r[2], r[3]) for r in rows})],
    }


def _timed(renderer: Any, spec: Any, spp: int, denoise: str) -> tuple[Any, float]:
    spec = replace(spec, render=replace(spec.render, spp=spp, denoise=denoise, seed=spp))
    live, posed = renderer._upload(spec)
    views = renderer._label(live, posed, spec)
    begun = time.process_time()
    linear, _ = renderer._picture(live, spec, 0, views[0])
    return linear, time.process_time() - begun


def _error(image: Any, truth: Any) -> float:
    floor = 0.02 * float(np.median(truth))
    return float(np.sqrt(np.mean((np.log(image + floor) - np.log(truth + floor)) ** 2)))


def _verdict(rows: dict[tuple[int, str], tuple[float, float]]) -> str:
    (fine, cheap), (raw, dear) = rows[8, "denoised"], rows[32, "raw"]
    return (
        f"8 denoised against 4 times the paths raw: error {fine / raw:.2f} x, "
        f"time {cheap / dear:.2f} x"
    )
