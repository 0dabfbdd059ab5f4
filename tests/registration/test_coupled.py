"""The coupled stage: detail that the model cannot express is found by the free mesh."""

from __future__ import annotations

import numpy as np

from synthgen.registration import fit
from synthgen.registration.coupled import edge_coupling
from synthgen.registration.simulated import ScanSettings, simulate_scan, with_detail
from synthgen.registration.simulated_body import BodyScanSettings, simulate_body_scan
from tests.registration import bodies
from tests.registration.hands import model, perturbed, rng, surface, truth


def test_properties_free_mesh_halves_the_surface_error() -> None:
    import igl

    s = surface()
    vertices = with_detail(s.at(truth()).vertices, s.faces, 4e-4, rng=rng("detail"))
    points, normals, seen = simulate_scan(vertices, s.faces, ScanSettings(), rng=rng("scan"))
    found = fit(points, normals, model(), perturbed(), "right", coupled=True)
    assert found.verdict != "fail"
    assert found.free_vertices is not None

    def off(mesh: np.ndarray) -> float:
        squared = igl.point_mesh_squared_distance(vertices, mesh, s.faces)[0]
        return float(np.sqrt(squared)[seen].mean())

    assert off(found.free_vertices) < 0.55 * off(found.vertices)
    assert off(found.free_vertices) < 1.8e-4


def test_reference_model_equations_are_the_gradient() -> None:
    s, h = surface(), 1e-6
    coupling = edge_coupling(s, 1e-3)
    x = truth()
    placed = s.at(x)
    free = placed.vertices + rng("free").normal(0, 1e-3, (s.n_vertices, 3))
    hessian, pull = coupling.model_equations(placed)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-6, atol=1e-3)
    gradient = np.tensordot(pull, placed.vertices - free, 2)

    def cost(y: np.ndarray) -> float:
        model = s.at(y).vertices
        tie = np.sum((free - model) ** 2) / coupling.offset_sd_m**2
        return float(np.sum(coupling.residual(free, model) ** 2) + tie)

    for k in (0, 5, 12, 20, 40):
        step = np.zeros(s.n)
        step[k] = h
        slope = (cost(x + step) - cost(x - step)) / (2 * h)
        np.testing.assert_allclose(2 * gradient[k], slope, rtol=1e-4, atol=1e-3)


def test_properties_free_body_takes_on_shapes_that_the_model_lacks() -> None:
    """Betas beyond the sixteenth, of a body of the same mesh."""
    import igl

    other, body = bodies.surface("cc0-supr"), bodies.surface()
    shape, pose, translation = other.unpack(bodies.truth(0, "cc0-supr"))
    vertices = other.at(other.pack(shape, pose, translation)).vertices
    settings = BodyScanSettings(points=60_000)
    found = simulate_body_scan(body.model, vertices, settings, rng=rng("unmodelled"))
    fitted = fit(found.points, found.normals, body.model, coupled=True)
    assert fitted.free_vertices is not None, fitted.reason

    def off(mesh: np.ndarray) -> float:
        return float(np.sqrt(igl.point_mesh_squared_distance(vertices, mesh, body.faces)[0]).mean())

    assert off(fitted.free_vertices) < 0.6 * off(fitted.vertices)
    assert off(fitted.free_vertices) < 6e-4


def test_properties_translation_costs_no_edge() -> None:
    s = surface()
    vertices = s.at(truth()).vertices
    moved = edge_coupling(s, 1e-3).residual(vertices + 0.1, vertices)
    assert np.abs(moved).max() < 1e-9


def test_edge_without_asking_there_is_none() -> None:
    from tests.registration.test_fit import cold

    assert cold().free_vertices is None
