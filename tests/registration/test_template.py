"""Bodies whose shape lies outside their model: the coupled stage, and a template from frames."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from synthgen import models
from synthgen.errors import ShapeError
from synthgen.models import BodyModel
from synthgen.registration.coupled import freed
from synthgen.registration.free_mesh import Topology, topology
from synthgen.registration.scan import scan_of
from synthgen.registration.simulated import ScanSettings, simulate_scan, with_shape
from synthgen.registration.template import Aligned, subject_template, unposed
from synthgen.sampling.streams import stream

NOISE_M, RESIDUAL_M = 7.5e-4, 1.7e-3
SCAN = ScanSettings(views=20, points=40_000, noise_m=NOISE_M, holes=0, pixels=240)


@lru_cache(maxsize=2)
def subject(name: str) -> tuple[BodyModel, BodyModel, Topology, np.ndarray]:
    """Model, the true subject's model, topology, betas."""
    from dataclasses import replace

    model = models.load(name)
    rng = stream(3, "sample", 0, 0, "residual shape")
    template = with_shape(model.v_template, RESIDUAL_M, rng=rng)
    true = replace(model, v_template=template, digest="true")
    beta = np.clip(stream(3, "sample", 0, 0, "betas").standard_normal(model.n_shape), -1.5, 1.5)
    return model, true, topology(model.faces, len(model.v_template)), beta


def frame(name: str, number: int, off_rad: float = 0.0015) -> tuple[Aligned, np.ndarray, float]:
    """A coupled frame, the true vertices, and its CPU seconds; parameters are a little off."""
    import time

    model, true, mesh, beta = subject(name)
    random = stream(number, "sample", 0, 0, "template frame")
    pose = random.normal(0, 0.15, (len(model.parents), 3))
    pose[0] *= 0.3
    vertices = true.evaluate(beta[None], pose[None]).vertices[0].astype(np.float64)
    points, normals, _ = simulate_scan(vertices, model.faces, SCAN, rng=random)
    fitted = pose + random.normal(0, off_rad, pose.shape)
    placed = model.evaluate(beta[None], fitted[None]).vertices[0].astype(np.float64)
    scan = scan_of(points, normals)
    began = time.process_time()
    free, seen = freed(mesh, placed, scan, NOISE_M)
    cpu = time.process_time() - began
    return Aligned(beta, fitted, np.zeros(3), free, seen), vertices, cpu


def surface_mm(mesh: np.ndarray, true: np.ndarray, faces: np.ndarray, some: np.ndarray) -> float:
    """Mean distance of true vertices from a mesh."""
    import igl

    squared = igl.point_mesh_squared_distance(true[some], mesh, faces)[0]
    return 1e3 * float(np.sqrt(squared).mean())


@pytest.mark.parametrize("name", ["cc0-body", "cc0-supr"])
def test_properties_the_free_body_finds_the_unmodelled_shape(name: str) -> None:
    model, _, mesh, _ = subject(name)
    aligned, true, _ = frame(name, 0)
    assert aligned.seen is not None
    placed = model.evaluate(aligned.shape[None], aligned.pose[None]).vertices[0].astype(np.float64)
    before = surface_mm(placed, true, mesh.faces, aligned.seen)
    after = surface_mm(aligned.vertices, true, mesh.faces, aligned.seen)
    assert before > 1.0
    assert after < 0.45


def test_properties_a_subjects_template_explains_new_frames() -> None:
    name = "cc0-body"
    model, _, mesh, beta = subject(name)
    frames = [frame(name, k)[0] for k in range(4)]
    own = subject_template(model, frames)
    assert own.digest != model.digest
    aligned, true, _ = frame(name, 9, off_rad=0.0)
    seen = aligned.seen
    assert seen is not None
    pose = aligned.pose[None]
    general = model.evaluate(beta[None], pose).vertices[0].astype(np.float64)
    special = own.evaluate(np.zeros((1, model.n_shape)), pose).vertices[0].astype(np.float64)
    before, after = (surface_mm(m, true, mesh.faces, seen) for m in (general, special))
    assert after < 0.6 * before


def test_reference_unposing_undoes_posing() -> None:
    model, true, _, beta = subject("cc0-body")
    pose = stream(1, "sample", 0, 0, "unpose").normal(0, 0.1, (len(model.parents), 3))
    posed = true.evaluate(beta[None], pose[None], np.array([[0.1, 0.2, 0.3]]))
    # the true joints move with the template: unpose by the same skeleton
    rest, weight = unposed(true, Aligned(beta, pose, np.array([0.1, 0.2, 0.3]), posed.vertices[0]))
    np.testing.assert_allclose(rest, true.shaped(beta)[0], atol=1e-6)
    assert (weight == 1).mean() > 0.99


def test_edge_no_frames_and_foreign_meshes() -> None:
    model, _, _, beta = subject("cc0-body")
    with pytest.raises(ShapeError, match="at least one"):
        subject_template(model, [])
    bad = Aligned(beta, np.zeros((len(model.parents), 3)), np.zeros(3), np.zeros((7, 3)))
    with pytest.raises(ShapeError, match="coupled stage"):
        subject_template(model, [bad])
