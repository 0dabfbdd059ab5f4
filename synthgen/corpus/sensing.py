"""What a depth sensor beside every camera of a corpus would have reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from synthgen.config import Config
from synthgen.corpus.columns import ScannedView, depth_steps, png
from synthgen.geometry.normals import vertex_normals
from synthgen.models import ManoModel, load_hand
from synthgen.render.renderer import RenderedView
from synthgen.render.sensor import LUMINANCE
from synthgen.render.solids import NOWHERE_M, place_solids, thing_solids, worn_solids
from synthgen.render.solids import Solid as DrawnSolid
from synthgen.sampling.draw import surface_of
from synthgen.sampling.spec import SampleSpec
from synthgen.sampling.streams import stream
from synthgen.scanner import ScanScene, Solid, Surface, load_rig
from synthgen.scanner.depth_sensor import sense_depth
from synthgen.scene import Background, HandSubject
from synthgen.scene.relief import relief_of
from synthgen.scene.surface import DrawnSurface

RIG = "consumer"
Attempt = Callable[[SampleSpec], tuple[str | None, list[RenderedView]]]
# Cloth, metal, wood and clay alike: a sensor sees grey, matt things.
THING = Surface(0.4, specular=0.2, subsurface=0.0)


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
    """Return everything of a sample as a scanner takes it, world, metres; unused slots left out."""
    scene = spec.scene
    hands, worn = [], []
    for k, subject in enumerate(scene.subjects):
        model = load_hand(subject.model, hand=subject.hand)
        hands.append(_hand(model, subject))
        worn += worn_solids(scene, k, model, subject)
    wall = Surface(_grey(scene.background), specular=0.0, subsurface=0.0)
    around = [(solid, wall) for solid in place_solids(scene)]
    around += [(solid, THING) for solid in [*worn, *thing_solids(scene)]]
    stands = [_stand(solid, look) for solid, look in around]
    return ScanScene((*hands, *(stand for stand in stands if len(stand.faces))))


def _hand(model: ManoModel, subject: HandSubject) -> Solid:
    drawn = DrawnSurface.for_model(model)
    relief = relief_of(model, subject.skin, np.array(subject.pose))
    vertices = _exact(drawn.refine(surface_of(model, subject), relief))
    grey = float(np.array(subject.skin.dorsal_rgb) @ LUMINANCE)
    skin = Surface(grey, roughness=subject.skin.roughness)
    return Solid(vertices, drawn.refined_faces, vertex_normals(vertices, drawn.refined_faces), skin)


def _stand(solid: DrawnSolid, look: Surface) -> Solid:
    """Return what is in its place of a mesh of slots; those that wait lie far below the floor."""
    here = np.all(solid.vertices[solid.triangles][..., 1] > NOWHERE_M[1] / 2, axis=1)
    ids, faces = np.unique(solid.triangles[here], return_inverse=True)
    faces = np.asarray(faces.reshape(-1, 3), dtype=np.int64)
    normals = None if solid.normals is None else solid.normals[ids]
    return Solid(solid.vertices[ids], faces, normals, look, kind="stand")


def _grey(background: Background) -> float:
    colours = np.array([background.colour_rgb, background.accent_rgb])
    return float(np.clip((colours @ LUMINANCE).mean(), 0.02, 0.95))


def _exact(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round to what the renderer holds, so that labels and sensor speak of one surface."""
    return vertices.astype(np.float32).astype(np.float64)
