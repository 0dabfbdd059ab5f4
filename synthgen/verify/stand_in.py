"""A scan of a sample's hand from a z-buffer, for corpora that simulate no scanner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.sample import Sample, Subject
from synthgen.models import pose_surface
from synthgen.registration.simulated import ScanSettings, simulate_scan
from synthgen.sampling.streams import stream
from synthgen.scanner import Scan
from synthgen.scene.relief import relief_of
from synthgen.scene.surface import DrawnSurface

SETTINGS = ScanSettings(points=12_000, outliers=0.0, pixels=150)


def scanned(sample: Sample) -> Scan:
    """Scan the first hand of a sample, as drawn, without its arm: points and normals alone."""
    rng = stream(0, "sample", sample.index, 0, "self test scan")
    vertices, faces = drawn_hand(sample.subjects[0])
    points, normals, _ = simulate_scan(vertices, faces, SETTINGS, rng=rng)
    n = len(points)
    return Scan(
        vertices=points.astype(np.float32),
        normals=normals.astype(np.float32),
        faces=np.zeros((0, 3), np.int32),
        colors=np.full((n, 3), 128, np.uint8),
        uv=np.zeros((n, 2), np.float32),
        corner_uv=np.zeros((0, 3, 2), np.float32),
        texture=np.full((8, 8, 3), 128, np.uint8),
        provenance={"barycentric": np.zeros((n, 3), np.float32)},
        level="model",
    )


def drawn_hand(truth: Subject) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (V, 3), world, and faces of a hand as it is drawn, without its arm."""
    drawn = DrawnSurface.for_model(truth.loaded)
    s = truth.description
    surface, _ = pose_surface(
        truth.loaded,
        truth.shape,
        truth.pose,
        truth.translation,
        np.array(s.wrist),
        np.array(s.elbow),
    )
    children = len(drawn.refined_faces) // len(truth.loaded.surface.faces)
    faces = drawn.refined_faces[: children * len(truth.loaded.faces)]
    used, own = np.unique(faces, return_inverse=True)
    relief = relief_of(truth.loaded, s.skin, truth.pose)
    return drawn.refine(surface, relief)[used], own.reshape(-1, 3)
