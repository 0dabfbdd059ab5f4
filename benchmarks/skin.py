"""What the skin costs: bake, a new person, a new pose, and pictures in full beside plain."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

PEOPLE, PICTURES = 6, 6


def run() -> dict[str, Any]:
    """Measure CPU seconds of each step at 1024 texels, and of samples with and without detail."""
    from synthgen.models import load
    from synthgen.render.skin.albedo import albedo
    from synthgen.render.skin.bake import bake_maps
    from synthgen.render.skin.surface import gloss, height_m
    from synthgen.sampling.appearance import sample_skin
    from synthgen.sampling.streams import stream
    from synthgen.scene.anatomy import anatomy_of

    model = load("cc0-hand")
    anatomy_of(model)
    maps = bake_maps(model, 256)  # compiles what is compiled
    rng = stream(0, "subject", 0, 0, "skin")
    people = [sample_skin((0.0, 1.0), rng=rng)[0] for _ in range(PEOPLE)]
    rows: list[list[Any]] = [
        ["bake of a topology, 1024", _cpu(lambda: bake_maps(model, 1024)), 6.0]
    ]
    maps = bake_maps(model, 1024)
    bent = np.zeros(16)
    rows += [
        ["albedo of a person, 1024", _mean(albedo, maps, people), 0.1],
        ["gloss of a person, 1024", _mean(gloss, maps, people), ""],
        ["heights of a pose, 1024", _mean(lambda m, s: height_m(m, s, bent), maps, people), ""],
    ]
    plain, detail = (_pictures(f"skin.detail={on}") for on in ("false", "true"))
    rows += [
        ["256 px, 8 spp, three colours", plain, ""],
        ["256 px, 8 spp, detail and relief", detail, ""],
    ]
    return {
        "title": "CPU seconds of skin",
        "columns": ["step", "CPU s", "target"],
        "rows": rows,
        "notes": [f"detail / three colours: {detail / plain:.2f}"],
    }


def _cpu(work: Callable[[], Any]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def _mean(work: Callable[[Any, Any], Any], maps: Any, people: list[Any]) -> float:
    work(maps, people[0])
    return _cpu(lambda: [work(maps, person) for person in people]) / len(people)


def _pictures(detail: str) -> float:
    """Mean CPU seconds of samples of different people, after two that compile kernels."""
    from synthgen.config import load_config
    from synthgen.render.renderer import Renderer
    from synthgen.sampling.draw import draw_sample

    same = ["light.constant=0", "light.room=0", "model.hands=right", "render.spp=8"]
    relief = ["skin.relief_m=0.002"] if detail.endswith("true") else []
    config = load_config("hand_rgbd", [*same, detail, *relief])
    specs = [draw_sample(config, index) for index in range(PICTURES + 2)]
    renderer = Renderer()
    for spec in specs[:2]:
        renderer.render(spec)
    return _cpu(lambda: [renderer.render(spec) for spec in specs[2:]]) / PICTURES
