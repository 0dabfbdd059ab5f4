"""Cost of one picture, phase by phase, beside making a fresh Mitsuba scene for each."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

WARM, ROUNDS = 4, 12
SETTINGS = ["light.room=0", "light.constant=0", "background.plain=0", "background.procedural=0",
            "background.room=0", "background.empty=1", "model.hands=right"]  # fmt: skip


def run() -> dict[str, Any]:
    """Time upload, labels and radiance of ours, then the same work on scenes loaded afresh."""
    from synthgen.config import load_config
    from synthgen.render.renderer import Renderer
    from synthgen.sampling.draw import draw_sample

    config = load_config("hand_rgbd", SETTINGS)
    renderer = Renderer(config.render.variant)
    times: dict[str, list[float]] = {}
    with threadpool_limits(limits=1):
        for k in range(WARM + ROUNDS):
            _one(renderer, draw_sample(config, k), times)
    rows = [[name, statistics.median(t[WARM:]), min(t[WARM:])] for name, t in times.items()]
    return {
        "title": f"256x256, 16 spp, nothing behind the hand, {ROUNDS} samples after {WARM}",
        "columns": ["what", "CPU s, median", "lowest"],
        "rows": rows,
        "notes": ["film AOVs are the usual way to labels: 1 jittered sample per pixel, depth, "
                  "normal, uv and ids alone; ours adds parts, faces, keypoints, in float64"],
    }  # fmt: skip


def _one(renderer: Any, spec: Any, times: dict[str, list[float]]) -> None:
    settings = spec.render
    live, posed = _timed(times, "upload", lambda: renderer._upload(spec))
    views = _timed(times, "labels", lambda: renderer._label(live, posed, spec))
    _timed(times, "radiance, developed", lambda: renderer._develop(live, spec, views))
    fresh = _timed(times, "fresh scene: load", live._load)
    _copy(live, fresh)
    sensor = _sensor(spec.scene.cameras[0])
    _timed(times, "fresh scene: film AOVs, 1 spp", lambda: _aovs(fresh, sensor))
    _timed(times, "fresh scene: radiance",
           lambda: _radiance(fresh, sensor, settings.spp, settings.max_depth))  # fmt: skip
    gc.collect()


def _timed(times: dict[str, list[float]], name: str, work: Callable[[], Any]) -> Any:
    from synthgen.render import backend

    begun = time.process_time()
    result = work()
    backend.drjit().sync_thread()
    times.setdefault(name, []).append(time.process_time() - begun)
    return result


def _copy(live: Any, fresh: Any) -> None:
    """Give a fresh scene the state of the live one."""
    from synthgen.render import backend

    params = backend.mitsuba().traverse(fresh)
    for key in live._params.keys():  # Mitsuba's parameters do not iterate keys
        if key in params:
            params[key] = live._params[key]
    params.update()


def _sensor(camera: Any) -> Any:
    """Mitsuba's own camera and film for the same view; its axes are ours but for two signs."""
    from synthgen.render import backend

    mi = backend.mitsuba()
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height,
            "pixel_format": "rgb", "component_format": "float32",
            "rfilter": {"type": "box"}}  # fmt: skip
    fov = float(2 * np.rad2deg(np.arctan(camera.width / 2 / camera.fx)))
    turned = camera.T @ np.diag([-1.0, -1.0, 1.0, 1.0])
    return mi.load_dict(
        {"type": "perspective", "fov": fov, "fov_axis": "x", "film": film,
         "sampler": {"type": "independent"}, "to_world": mi.ScalarTransform4f(turned)}
    )  # fmt: skip


def _aovs(scene: Any, sensor: Any) -> Any:
    from synthgen.render import backend

    mi = backend.mitsuba()
    integrator = mi.load_dict(
        {"type": "aov", "aovs": "z:depth,n:sh_normal,t:uv,p:prim_index,s:shape_index"}
    )
    return np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=1))


def _radiance(scene: Any, sensor: Any, spp: int, max_depth: int) -> Any:
    from synthgen.render import backend

    mi = backend.mitsuba()
    integrator = mi.load_dict({"type": "path", "max_depth": max_depth})
    return np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=spp))
