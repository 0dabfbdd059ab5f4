"""LM and dogleg on a known problem and on a scan."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.errors import ShapeError
from synthgen.registration.schedule import (
    CLOSE,
    PRESETS,
    pca_basis,
    preset_named,
    run_stage,
)
from synthgen.registration.solver import MAX_TRIALS, Energy, Method, minimise, wrapped
from synthgen.registration.surface import Placed
from synthgen.registration.terms import Block, GaussianPrior, KeypointTerm, shape_prior
from tests.registration.hands import error_mm, model, rng, scan, surface, truth

METHODS: tuple[Method, ...] = ("lm", "dogleg")


@pytest.mark.parametrize("method", METHODS)
def test_reference_quadratic_is_solved(method: Method) -> None:
    s = surface()
    mean = rng("quadratic").normal(0, 0.2, s.n)
    energy = Energy(s, [GaussianPrior(slice(0, s.n), mean, np.full(s.n, 0.1))])
    found = minimise(energy, np.zeros(s.n), iterations=25, method=method)
    np.testing.assert_allclose(found.x, mean, atol=1e-4)
    assert found.trial.cost < 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_properties_keypoints_alone_place_the_joints(method: Method) -> None:
    s = surface()
    target = s.at(truth()).joints
    start = truth() + rng("keypoints").normal(0, 0.1, s.n) * (np.arange(s.n) < s.n - 3)
    energy = Energy(s, [KeypointTerm(np.arange(16), target, 1e-3), shape_prior(s, 1e-3)])
    found = minimise(energy, start, iterations=30, method=method)
    off = np.linalg.norm(found.trial.placed.joints - target, axis=1)
    assert off.max() < 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_properties_a_stage_lowers_the_error(method: Method) -> None:
    start = truth() + rng("stage").normal(0, 0.05, surface().n) * (np.arange(surface().n) < 58)
    before = error_mm(surface().at(start).vertices)
    found = run_stage(surface(), scan(), start, CLOSE, [shape_prior(surface())], method=method)
    assert error_mm(found.trial.placed.vertices) < 0.5 * before


def test_properties_a_basis_is_kept_to() -> None:
    start, s = truth() + 0.02, surface()
    free = [s.shape.start, *range(s.root.start, s.root.stop), *range(s.n - 3, s.n)]
    found = run_stage(s, scan(), start, CLOSE, [], basis=np.eye(s.n)[:, free])
    assert np.flatnonzero(np.abs(found.x - start) > 1e-12).tolist() == free


@pytest.mark.parametrize("components", [6, 45])
def test_properties_pca_basis_keeps_fingers_in_its_span(components: int) -> None:
    s = surface()
    basis = pca_basis(s, components)
    assert basis.shape == (s.n, s.n - 45 + components)
    directions = model().hands_components
    assert directions is not None
    fingers = basis[s.fingers] @ rng("pca").standard_normal(basis.shape[1])
    fit = np.linalg.lstsq(directions[:components].T, fingers, rcond=None)[0]
    np.testing.assert_allclose(directions[:components].T @ fit, fingers, atol=1e-9)


def test_properties_wrapping_keeps_the_hand() -> None:
    s = surface()
    x = truth().copy()
    theta = x[s.root]
    x[s.root] = theta / np.linalg.norm(theta) * (np.linalg.norm(theta) + 2 * np.pi)
    again = wrapped(s, x)
    assert np.linalg.norm(again[s.root]) <= np.pi + 1e-9
    np.testing.assert_allclose(s.at(again).vertices, s.at(x).vertices, atol=1e-9)


def test_reference_the_papers_weights() -> None:
    """From lambda_a = 100 to 500: the data by lambda_a, the pose prior by its inverse."""
    stages = preset_named("paper").finish
    assert (stages[0].n_eff, stages[-1].n_eff) == (100, 500)
    assert {stage.n_eff * stage.prior for stage in stages} == {100}
    assert {stage.mesh_to_scan for stage in stages} == {0.1}


def test_edge_unknown_preset_and_components() -> None:
    assert set(PRESETS) == {"paper", "fast", "accurate"}
    with pytest.raises(ShapeError, match="did you mean 'fast'"):
        preset_named("fats")
    with pytest.raises(ShapeError, match="6 to 45"):
        pca_basis(surface(), 3)


class Refusing:
    """Costs more at every look, so that no step is kept; the residual is ``residual`` times 1."""

    def __init__(self, residual: float) -> None:
        self.residual, self.looks = residual, 0

    def match(self, placed: Placed) -> None:
        self.looks += 1

    def cost(self, placed: Placed, match: None) -> float:
        return 1.0 + self.looks

    def blocks(self, placed: Placed, match: None) -> list[Block]:
        return [Block(np.array([self.residual]), np.eye(1, placed.surface.n), np.ones(1))]


@pytest.mark.parametrize(("residual", "tries"), [(1.0, MAX_TRIALS), (1e-3, 1)])
def test_properties_a_step_without_promise_is_not_shortened(residual: float, tries: int) -> None:
    term = Refusing(residual)
    found = minimise(Energy(surface(), [term]), truth(), iterations=3)
    assert found.reason == "stuck"
    assert term.looks == 1 + tries
