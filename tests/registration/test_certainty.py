"""Predicted standard deviations against errors, and what they are made of."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from synthgen.cli import bench
from synthgen.registration.certainty import FOREIGN, Earlier, covariance, normal_rows
from synthgen.registration.correspondences import closest
from synthgen.registration.fit import fit
from synthgen.registration.schedule import LAST, stage_terms
from synthgen.registration.solver import Energy, gram
from synthgen.registration.terms import GaussianPrior, MixturePrior, Term
from tests.registration import bodies
from tests.registration.hands import model, rng, scan, surface, truth

NOISES_M = (2e-4, 5e-4, 1e-3)


def ratios(n: int, noise_m: float, seed: int) -> np.ndarray:
    """RMS error over RMS predicted error of each of n scans that are not failed."""
    benchmark = bench._load(bench.FOLDER / "registration.py")
    found = []
    for k in range(n):
        case = benchmark.make_case(k, seed, noise_m)
        one = fit(case.points, case.normals, model(), benchmark.perturbed(case), "right")
        if one.verdict != "fail":
            off = np.linalg.norm(one.vertices - case.vertices, axis=1)
            found.append(np.sqrt(np.mean(off**2) / np.mean(one.vertex_sd_m**2)))
    return np.array(found)


@pytest.mark.parametrize("noise_m", NOISES_M)
def test_properties_errors_are_as_large_as_predicted(noise_m: float) -> None:
    """Of few scans: the median of seven is within about a sixth of that of many."""
    found = ratios(7, noise_m, 31)
    assert len(found) >= 6
    assert 0.7 < np.median(found) < 1.4


@pytest.mark.prove
@pytest.mark.parametrize("noise_m", NOISES_M)
def test_properties_predictions_are_calibrated(noise_m: float) -> None:
    found = ratios(60, noise_m, 32)
    assert len(found) >= 55
    assert 0.8 < np.median(found) < 1.25


def only(terms: list[Term]) -> np.ndarray:
    energy = Energy(surface(), terms)
    return covariance(energy, energy.at(truth()))


def everywhere(sd: np.ndarray) -> Term:
    return GaussianPrior(slice(0, surface().n), truth().copy(), sd)


def test_reference_without_points_it_is_the_priors() -> None:
    sd = rng("sd").uniform(0.5, 2, surface().n)
    np.testing.assert_allclose(only([everywhere(sd)]), np.diag(sd**2), rtol=1e-9, atol=1e-12)


def test_properties_a_mixture_is_not_believed_as_it_stands() -> None:
    """Poses that it never saw lie farther off."""
    where, n = surface().fingers, surface().n
    rest = np.setdiff1d(np.arange(n), np.r_[where])
    known = GaussianPrior(rest, truth()[rest], np.ones(len(rest)))
    mixture = MixturePrior(where, truth()[where][None], np.eye(45)[None], np.zeros(1))
    found = np.diag(only([known, mixture]))
    np.testing.assert_allclose(found[where], FOREIGN, rtol=1e-9)
    np.testing.assert_allclose(found[rest], 1, rtol=1e-9)


@lru_cache(maxsize=2)
def of_points(noise_m: float, together: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Covariance with the scan of the tripod, and the inverse Hessian."""
    from dataclasses import replace

    prior = everywhere(np.full(surface().n, 0.3))
    terms = stage_terms(scan(), replace(LAST, noise_m=noise_m), [prior])
    energy = Energy(surface(), terms)
    trial = energy.at(truth())
    found = covariance(energy, trial, together=together)
    return found, np.linalg.inv(energy.normal_equations(trial)[0])


def test_properties_it_is_near_the_inverse_hessian_at_little_noise() -> None:
    found, inverse = of_points(2e-4)
    ratio = np.sqrt(np.diag(found) / np.diag(inverse))
    assert 0.8 < np.median(ratio) < 1.3


def test_properties_points_that_err_together_tell_less() -> None:
    one, four = of_points(2e-4)[0], of_points(2e-4, 4.0)[0]
    assert (np.diag(four) > np.diag(one)).all()
    assert 1.5 < np.median(np.sqrt(np.diag(four) / np.diag(one))) <= 2


def test_reference_in_turn_or_at_once() -> None:
    """Shape first, the rest after it, from the same points: as if all were fitted together."""
    s = surface()
    terms = stage_terms(scan(), LAST, [everywhere(np.full(s.n, 0.3))])
    energy = Energy(s, terms)
    trial = energy.at(truth())
    rest = np.eye(s.n)[:, s.shape.stop :]
    assert s.shape.start == 0
    known = covariance(energy, trial, basis=rest)
    turn = covariance(energy, trial, basis=rest, earlier=Earlier(s.shape, np.eye(s.n)))
    once = covariance(energy, trial)
    np.testing.assert_allclose(turn, once, atol=1e-6 * np.abs(once).max())
    where = s.translation, s.translation
    assert (np.diag(turn[where]) > 1.3 * np.diag(known[where])).all()


def test_properties_what_was_fitted_earlier_is_as_certain_as_then() -> None:
    s = surface()
    energy = Energy(s, stage_terms(scan(), LAST, [everywhere(np.full(s.n, 0.3))]))
    trial, first = energy.at(truth()), np.eye(s.n)[:, s.shape]
    rest = np.eye(s.n)[:, s.shape.stop :]
    found = covariance(energy, trial, basis=rest, earlier=Earlier(s.shape, first))
    alone = covariance(energy, trial, basis=first)
    own = s.shape, s.shape
    np.testing.assert_allclose(found[own], alone[own], atol=1e-6 * np.abs(alone[own]).max())


def test_reference_sums_of_sparse_rows() -> None:
    random = rng("gram")
    rows = random.normal(size=(50, 120)) * (random.random((50, 120)) < 0.2)
    weight = random.random(50)
    np.testing.assert_allclose(gram(rows, weight), rows.T @ np.diag(weight) @ rows, atol=1e-12)
    np.testing.assert_allclose(
        gram(rows[:, :9], weight), rows[:, :9].T @ np.diag(weight) @ rows[:, :9], atol=1e-12
    )


@pytest.mark.parametrize("kind", ["hand", "body"])
def test_reference_normals_turn_as_finite_differences(kind: str) -> None:
    """Sum of squares over many points: triangles' own turns stand for interpolated ones."""
    s, x = (surface(), truth()) if kind == "hand" else (bodies.surface(), bodies.truth())
    points, normals = (scan().points, scan().normals) if kind == "hand" else bodies.scanned()
    points, normals = points[:3000], normals[:3000]
    placed = s.at(x)
    pairs = closest(placed, points, normals, cut_m=0.01, cosine=-2.0, neighbours=4)
    rows, bend = normal_rows(placed, pairs.triangle, pairs.barycentric, pairs.normal)
    flat = (bend < 150) & pairs.kept & (pairs.squared < 0.002**2)
    random = rng("turn")
    for where in (s.root, s.translation, s.shape):
        step = np.zeros(s.n)
        step[where] = random.standard_normal(len(step[where]))
        step *= (0.03 if where == s.shape else 1e-4) / np.linalg.norm(step)
        ends = [closest(s.at(x + h * step), points, normals, cut_m=0.01, cosine=-2.0, neighbours=4)
                for h in (1, -1)]  # fmt: skip
        same = flat & (ends[0].triangle == ends[1].triangle).all(axis=1)
        assert same.mean() > 0.5
        turned = np.sum(((ends[0].normal - ends[1].normal) / 2) ** 2, axis=1)[same].sum()
        promised = np.sum((rows @ step).reshape(-1, 2) ** 2, axis=1)[same].sum()
        assert promised == pytest.approx(turned, rel=0.35)
