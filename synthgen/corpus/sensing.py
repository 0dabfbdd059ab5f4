"""What a depth sensor beside every camera of a corpus would have reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from synthgen.config import Config
from synthgen.corpus.columns import ScannedView, depth_steps, png
from synthgen.geometry.normals import vertex_normals
from synthgen.models import load
from synthgen.render.background import wall_geometry, wall_triangles
from synthgen.render.renderer import RenderedView
from synthgen.sampling.draw import surface_of
from synthgen.sampling.spec import SampleSpec
from synthgen.sampling.streams import stream
from synthgen.scanner import ScanScene, Solid, Surface, load_rig
from synthgen.scanner.depth_sensor import sense_depth
from synthgen.scene import Background, HandSubject
from synthgen.scene.surface import DrawnSurface

RIG = "consumer"
Attempt = Callable[[SampleSpec], tuple[str | None, list[RenderedView]]]
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


class DepthSensing:
    """Adds sensor depth to the views that another maker makes."""

    def __init__(self, config: Config, inner: Attempt) -> None:
        self._config, self._inner = config, inner
        self._rig = load_rig(RIG, config.scanner.seed)

    def attempt(self, spec: SampleSpec) -> tuple[str | None, list[RenderedView]]:
        """Make the views of a sample and measure their depth."""
        reason, views = self._inner(spec)
        if reason is not None:
            return reason, views
        return None, [self._sensed(spec, k, view) for k, view in enumerate(views)]

    def _sensed(self, spec: SampleSpec, number: int, view: RenderedView) -> ScannedView:
        level = self._config.render.sensor_depth
        assert level != "off"
        rng = stream(
            self._config.seed, "sample", spec.index, spec.attempt, f"depth sensor {number}"
        )
        found = sense_depth(scene_before(spec), view.camera, self._rig, rng=rng, level=level)
        members = {"depth": {"sensor.png": png(depth_steps(found.depth_z_m))}}
        facts = {"sensor_depth": {"rig": RIG, "level": level, "problem": found.problem}}
        if isinstance(view, ScannedView):
            return replace(view, members=members | view.members, facts=facts | view.facts)
        own = {f.name: getattr(view, f.name) for f in fields(RenderedView)}
        return ScannedView(**own, members=members, facts=facts)


def scene_before(spec: SampleSpec) -> ScanScene:
    """Return hands and walls of a sample as a scanner takes them, world, metres."""
    hands = tuple(_hand(subject) for subject in spec.scene.subjects)
    background = spec.scene.background
    if background.kind == "empty":
        return ScanScene(hands)
    corners, _ = wall_geometry(background, spec.scene.cameras[0])
    triangles = wall_triangles().astype(np.int64)
    if background.kind != "room":
        corners, triangles = corners[:4], triangles[:2]  # the other quads hide behind the first
    wall = Surface(_grey(background), specular=0.0, subsurface=0.0)
    return ScanScene((*hands, Solid(_exact(corners), triangles, None, wall, kind="stand")))


def _hand(subject: HandSubject) -> Solid:
    model = load(subject.model, hand=subject.hand)
    drawn = DrawnSurface.for_model(model)
    vertices = _exact(drawn.refine(surface_of(model, subject)))
    skin = Surface(float(np.array(subject.skin.dorsal_rgb) @ _LUMINANCE))
    return Solid(vertices, drawn.refined_faces, vertex_normals(vertices, drawn.refined_faces), skin)


def _grey(background: Background) -> float:
    colours = np.array([background.colour_rgb, background.accent_rgb])
    return float(np.clip((colours @ _LUMINANCE).mean(), 0.02, 0.95))


def _exact(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round to what the renderer holds, so that labels and sensor speak of one surface."""
    return vertices.astype(np.float32).astype(np.float64)
