"""A renderer that is quick: labels of a square, colours from the sample's own stream."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from synthgen.config import Config
from synthgen.models.joints import OPENPOSE21_NAMES
from synthgen.render.labels import Labels
from synthgen.render.renderer import RenderedView
from synthgen.render.visibility import HandLabels
from synthgen.sampling.spec import SampleSpec
from synthgen.sampling.streams import stream

Attempt = Callable[[SampleSpec], tuple[str | None, list[RenderedView]]]


def view_of(spec: SampleSpec, number: int) -> RenderedView:
    camera = spec.scene.cameras[number]
    h, w = camera.height, camera.width
    rng = stream(spec.render.seed, "sample", spec.index, spec.attempt, "fake")
    image = rng.integers(0, 255, (h, w, 3), dtype=np.uint8)
    mask = np.zeros((h, w), dtype=np.uint8)
    mask[h // 4 : h // 2, w // 4 : w // 2] = 1
    normals = np.zeros((h, w, 3), dtype=np.float32)
    normals[..., 2] = -1
    labels = Labels(
        depth_z_m=np.full((h, w), 0.5, np.float32), distance_m=np.full((h, w), 0.6, np.float32),
        normals=normals, uv=np.zeros((h, w, 2), np.float32), part_id=mask, instance_id=mask,
        face_id=mask.astype(np.int32) - 1, barycentric=np.zeros((h, w, 3), np.float32),
        valid=np.ones((h, w), bool),
    )  # fmt: skip
    n = len(OPENPOSE21_NAMES)
    hand = HandLabels(np.zeros((n, 2), np.float32), np.ones((n, 3), np.float32),
                      np.full(n, 2, np.uint8))  # fmt: skip
    return RenderedView(camera, labels, (hand,), image.astype(np.float32) / 255, image, 1.0)


def quick(config: Config) -> Attempt:
    """Render at once."""
    return lambda spec: (None, [view_of(spec, k) for k in range(len(spec.scene.cameras))])


def slow(config: Config) -> Attempt:
    """Render with a pause, so that a run can be interrupted."""

    def attempt(spec: SampleSpec) -> tuple[str | None, list[RenderedView]]:
        time.sleep(0.05)
        return None, [view_of(spec, 0)]

    return attempt


def picky(config: Config) -> Attempt:
    """Reject the first attempt at odd samples."""

    def attempt(spec: SampleSpec) -> tuple[str | None, list[RenderedView]]:
        if spec.index % 2 and spec.attempt == 0:
            return "odd", []
        return None, [view_of(spec, 0)]

    return attempt


def never(config: Config) -> Attempt:
    """Reject everything."""
    return lambda spec: ("nothing pleases", [])


def suicidal(config: Config) -> Attempt:
    """Die once, at sample 3: a marker file remembers it."""

    def attempt(spec: SampleSpec) -> tuple[str | None, list[RenderedView]]:
        marker = Path(os.environ["SYNTHGEN_TEST_MARKER"])
        if spec.index == 3 and not marker.exists():
            marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return None, [view_of(spec, 0)]

    return attempt


def deadly(config: Config) -> Attempt:
    """Die always."""

    def attempt(spec: SampleSpec) -> tuple[str | None, list[RenderedView]]:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError

    return attempt
