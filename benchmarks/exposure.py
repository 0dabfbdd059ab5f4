"""Cost of a full hand5 scan's pictures, step by step, beside Mitsuba's own projector and `direct`.

Ours has all ten projectors in every sample, deterministically; Mitsuba's `direct` picks one of them
at random per sample, so that its pictures are noisy: the noise column says how much.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

SPP = 4
SHOWN = 1  # the unit that sees most of the hand


def run() -> dict[str, Any]:
    """Time preparation, five speckle pairs, five colour pictures, single effects, and the peer."""
    from synthgen.scanner import Effects, load_rig

    rig, scene = load_rig("hand5"), _hand()
    unit = rig.units[SHOWN]
    rows: list[list[Any]] = []
    with threadpool_limits(limits=1):
        _warm(scene, rig)
        stage, spent = _timed(lambda: _stage(scene, rig))
        rows.append(["prepare: split, upload, heat flow", spent, None])
        pictures = _timed(lambda: [_expose(stage, u) for u in rig.units])[1]
        rows.append(["5 speckle pairs, 10 projectors, all effects, sensors", pictures, None])
        rows.append(["  both", spent + pictures, None])
        rows.append(["5 colour pictures", _timed(lambda: [_colour(stage, u) for u in rig.units])[1],
                     None])  # fmt: skip
        for name, effects in (
            ("one picture, light already at the vertices", Effects()),
            ("  every shadow by a ray", Effects(vertex_cache=False)),
            ("  no shadows", Effects(shadows=False)),
            ("  no gloss", Effects(specular=False)),
            ("  sharp projectors", Effects(defocus=False)),
        ):
            stage = _stage(scene, rig, effects)
            _radiance(stage, unit)
            image, cost = _timed(lambda stage=stage: _radiance(stage, unit))
            rows.append(
                [name, cost, _noise(image, _radiance(_stage(scene, rig, effects, 1), unit))]
            )
        images, cost = _stock(stage, unit)
        rows.append([f"Mitsuba projector + direct, {SPP} spp", cost, _noise(*images)])
    return {
        "title": f"hand5, 1624x1236, {SPP} spp, {len(stage.mesh.faces):,} triangles, CPU seconds",
        "columns": ["what", "CPU s", "noise"],
        "rows": [[cell if cell is not None else "" for cell in row] for row in rows],
        "notes": ["noise: RMS difference of two seeds over sqrt(2), by the mean, on the hand"],
    }


def _hand() -> Any:
    from synthgen.config import load_config
    from synthgen.sampling.draw import draw_sample
    from synthgen.scanner import ScanScene
    from synthgen.scanner.hand import hand_solid, put_in_rig

    subject = draw_sample(load_config("hand_rgbd", []), 0).scene.subjects[0]
    return ScanScene((hand_solid(put_in_rig(subject)).solid,))


def _stage(scene: Any, rig: Any, effects: Any = None, seed: int = 0) -> Any:
    from synthgen.sampling.streams import stream
    from synthgen.scanner import Effects
    from synthgen.scanner.stage import prepare

    rng = stream(seed, "sample", 0, 0, "benchmark")
    return prepare(scene, replace(rig, sync_s=0.0), rng=rng, effects=effects or Effects())


def _expose(stage: Any, unit: Any) -> Any:
    from synthgen.scanner.exposure import expose

    return expose(stage, unit, spp=SPP)


def _colour(stage: Any, unit: Any) -> Any:
    from synthgen.scanner.white import expose_colour

    return expose_colour(stage, unit, spp=SPP)


def _radiance(stage: Any, unit: Any) -> Any:
    from synthgen.scanner.exposure import speckle_radiance

    return speckle_radiance(stage, unit, "left", spp=SPP)


def _warm(scene: Any, rig: Any) -> None:
    """Compile the kernels and make the slides, which later scans of a process find made."""
    stage = _stage(scene, rig)
    _expose(stage, rig.units[0])
    _colour(stage, rig.units[0])


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    begun = time.process_time()
    result = work()
    return result, time.process_time() - begun


def _noise(a: Any, b: Any) -> float:
    hand = (a > 0.02) & (b > 0.02)
    return float(np.sqrt(((a - b)[hand] ** 2).mean() / 2) / a[hand].mean())


def _stock(stage: Any, unit: Any) -> tuple[list[Any], float]:
    """Render the same picture with Mitsuba's plugins alone."""
    from synthgen.render import backend

    mi = backend.mitsuba()
    scene = _stock_scene(mi, stage, unit)
    integrator = mi.load_dict({"type": "direct", "hide_emitters": True})

    def render(seed: int) -> Any:
        return np.array(mi.render(scene, integrator=integrator, spp=SPP, seed=seed))[..., 0]

    render(0)
    first, spent = _timed(lambda: render(1))
    return [first, render(2)], spent


def _stock_scene(mi: Any, stage: Any, unit: Any) -> Any:
    from synthgen.scanner.pattern import slide

    camera = unit.true.left
    mesh = stage.mesh
    shape = mi.Mesh("hand", len(mesh.vertices), len(mesh.faces), has_vertex_normals=True)
    params = mi.traverse(shape)
    params["faces"] = mi.UInt32(mesh.faces.astype(np.uint32).ravel())
    params["vertex_positions"] = mi.Float(mesh.vertices.astype(np.float32).ravel())
    params["vertex_normals"] = mi.Float(mesh.normals.astype(np.float32).ravel())
    params.update()
    content: dict[str, Any] = {
        "type": "scene", "hand": shape, "ambient": {"type": "constant", "radiance": 0.05},
        "sensor": {"type": "perspective", "to_world": _pose(mi, camera.T), "fov_axis": "x",
                   "fov": _field(camera), "near_clip": 0.01,
                   "film": {"type": "hdrfilm", "width": camera.width, "height": camera.height,
                            "pixel_format": "luminance", "rfilter": {"type": "box"}}},
    }  # fmt: skip
    for k, projector in enumerate(stage.rig.projectors):
        texture = {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(
            slide(projector.pattern, projector.optics.width)[..., None])}  # fmt: skip
        content[f"projector{k}"] = {
            "type": "projector", "irradiance": texture, "fov": _field(projector.optics),
            "scale": projector.irradiance * projector.focus_m**2 * np.pi,
            "to_world": _pose(mi, projector.optics.T),
        }  # fmt: skip
    return mi.load_dict(content)


def _pose(mi: Any, T: Any) -> Any:
    return mi.ScalarTransform4f(T @ np.diag([-1.0, -1.0, 1.0, 1.0]))


def _field(camera: Any) -> float:
    return float(np.rad2deg(2 * np.arctan(camera.width / 2 / camera.fx)))
