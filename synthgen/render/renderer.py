"""Render samples: labels first, then the picture; scenes persist between samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera
from synthgen.models import ManoModel, Posed, load_hand, openpose21, pose_surface
from synthgen.render import backend
from synthgen.render.denoise import denoise
from synthgen.render.diffusion import diffuse
from synthgen.render.labels import Labels, label_view
from synthgen.render.radiance import Film, Guides, mean_guides
from synthgen.render.sensor import develop
from synthgen.render.upload import LiveScene, Skins, Structure
from synthgen.render.visibility import VISIBLE, HandLabels, label_hand
from synthgen.sampling.spec import SampleSpec
from synthgen.scene import HandSubject, Optics

# A sample is rejected when a hand covers less of the picture, or shows fewer keypoints.
SMALLEST_SHARE = 0.015
FEWEST_VISIBLE = 4
# Rays per pixel that look for albedo and normals.
GUIDE_SPP = 4


@dataclass(frozen=True, eq=False)
class RenderedView:
    """Everything that one camera yields.

    ``linear`` (H, W, 3) float32 radiance and ``image`` (H, W, 3) uint8 sRGB are None where only
    labels were asked for; ``exposure`` is the factor between them.
    """

    camera: Camera
    labels: Labels
    hands: tuple[HandLabels, ...]
    linear: NDArray[np.float32] | None
    image: NDArray[np.uint8] | None
    exposure: float


class Renderer:
    """Renders samples one after the other; holds one Mitsuba scene per structure.

    Parameters
    ----------
    variant : {"auto", "llvm_ad_rgb", "cuda_ad_rgb"}
        See :func:`synthgen.render.backend.activate`.
    """

    def __init__(self, variant: str = "auto") -> None:
        self.variant = backend.activate(variant)
        self._scenes: dict[Structure, LiveScene] = {}
        self._skins = Skins()

    def render(self, spec: SampleSpec) -> list[RenderedView]:
        """Return labels and pictures of every view of a sample."""
        live, posed = self._upload(spec)
        return self._develop(live, spec, self._label(live, posed, spec))

    def labels(self, spec: SampleSpec) -> list[RenderedView]:
        """Return labels alone, a small part of the cost."""
        live, posed = self._upload(spec)
        return self._label(live, posed, spec)

    def attempt(self, spec: SampleSpec) -> tuple[str | None, list[RenderedView]]:
        """Label a sample and, unless it must be drawn again, render it.

        Returns
        -------
        reason : str or None
            Why it was rejected; nothing is rendered then.
        views : list of RenderedView
        """
        live, posed = self._upload(spec)
        views = self._label(live, posed, spec)
        reason = rejection(views)
        return (reason, []) if reason else (None, self._develop(live, spec, views))

    def check(self, spec: SampleSpec) -> str | None:
        """Return why a sample must be drawn again, or None; needs labels alone."""
        return rejection(self.labels(spec))

    def _label(self, live: LiveScene, posed: list[Posed], spec: SampleSpec) -> list[RenderedView]:
        views = []
        for camera in spec.scene.cameras:
            hands = tuple(
                label_hand(live, k, openpose21(m, p)[0].astype(np.float64), camera)
                for k, (m, p) in enumerate(zip(live.models, posed, strict=True))
            )
            views.append(RenderedView(camera, label_view(live, camera), hands, None, None, 1.0))
        return views

    def _develop(
        self, live: LiveScene, spec: SampleSpec, views: list[RenderedView]
    ) -> list[RenderedView]:
        done = []
        for number, view in enumerate(views):
            linear, guides = self._picture(live, spec, number, view)
            albedo = None if guides is None else guides.albedo
            image, exposure = develop(linear, spec.scene.sensor, albedo, number)
            done.append(replace(view, linear=linear, image=image, exposure=exposure))
        return done

    def _picture(
        self, live: LiveScene, spec: SampleSpec, number: int, view: RenderedView
    ) -> tuple[NDArray[np.float32], Guides | None]:
        """Trace one view, denoise it and spread light under the skin, as the spec says."""
        scene, settings = spec.scene, spec.render
        film = Film(live, view.camera, scene.optics[number] if scene.optics else Optics())
        seed = (settings.seed + 7919 * number) % 2**31
        guided = settings.denoise == "oidn" or settings.diffusion or scene.sensor.white_balance
        steps = min(scene.motion.steps, settings.spp) if scene.motion is not None else 1
        linear: NDArray[np.float32] | None = None
        parts: list[Guides] = []
        for step in range(steps):
            if steps > 1:
                live.move(scene, (step + 0.5) / steps - 0.5)
            begin, end = step * settings.spp // steps, (step + 1) * settings.spp // steps
            key = (seed + 15_485_863 * step) % 2**31
            part = film.radiance(end - begin, settings.max_depth, key)
            # Every moment counts alike, or the picture's middle would not be the motion's.
            part = part * np.float32(1 / steps)
            linear = part if linear is None else linear + part
            if guided:
                parts.append(film.guides(max(1, GUIDE_SPP // steps), key))
        if steps > 1:
            live.move(scene, 0.0)
        assert linear is not None
        guides = mean_guides(parts) if parts else None
        if guides is not None and settings.denoise == "oidn":
            linear = denoise(linear, guides)
        sharp = steps == 1 and not any(o.aperture_m > 0 for o in scene.optics)
        if guides is not None and settings.diffusion and sharp:  # blur hides it and mixes albedos
            linear = diffuse(linear, guides.albedo, view.labels, view.camera)
        return linear, guides

    def _upload(self, spec: SampleSpec) -> tuple[LiveScene, list[Posed]]:
        scene = spec.scene
        models = tuple(load_hand(s.model, hand=s.hand) for s in scene.subjects)
        structure = Structure.of(scene, models, spec.render.quality)
        results = [_pose(m, s) for m, s in zip(models, scene.subjects, strict=True)]
        surfaces = [surface for surface, _ in results]
        if structure not in self._scenes:
            self._scenes[structure] = LiveScene(models, structure, self._skins)
            # The first update turns what the loader left as literals into data: other kernels,
            # other last bits. Nothing may be drawn before it.
            self._scenes[structure].update(scene, surfaces)
        live = self._scenes[structure]
        live.update(scene, surfaces)
        return live, [posed for _, posed in results]


def rejection(views: list[RenderedView]) -> str | None:
    """Return why labelled views make a bad sample, or None."""
    for number, view in enumerate(views):
        for k, hand in enumerate(view.hands):
            own = (view.labels.instance_id == k + 1) & (view.labels.part_id <= 16)
            share = float(own.mean())
            if share < SMALLEST_SHARE:
                return f"view {number}: hand {k} covers {share:.4f} of the picture"
            if np.sum(hand.keypoints_state == VISIBLE) < FEWEST_VISIBLE:
                return f"view {number}: hand {k} shows fewer than {FEWEST_VISIBLE} keypoints"
    return None


def _pose(model: ManoModel, subject: HandSubject) -> tuple[NDArray[np.float32], Posed]:
    return pose_surface(
        model,
        np.array(subject.shape),
        np.array(subject.pose),
        np.array(subject.translation_m),
        np.array(subject.wrist),
        np.array(subject.elbow),
    )
