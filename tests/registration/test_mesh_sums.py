"""Points summed on the mesh against one row per point."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.registration.correspondences import closest
from synthgen.registration.mesh_sums import summed
from synthgen.registration.solver import Energy
from synthgen.registration.surface import Surface
from synthgen.registration.terms import GemanMcClure, ScanToMesh
from tests.registration.hands import model, rng, scan, truth


@pytest.mark.parametrize("curved", [0.0, 0.75])
def test_reference_one_row_per_point(curved: float) -> None:
    s = Surface(model())  # its own: the size from which it sums is changed below
    x = truth() + rng("sums").normal(0, 0.003, s.n)
    points, normals = scan().points[:2000], scan().normals[:2000]
    term = ScanToMesh(points, normals, 3.0, GemanMcClure(2e-3), 0.01, 0.5, curved=curved)
    energy = Energy(s, [term])
    trial = energy.at(x)
    assert 0 < trial.matches[0].kept.sum() < 2000
    by_rows = energy.normal_equations(trial)
    s.summed_from = 0
    for whole, own in zip(energy.normal_equations(trial), by_rows, strict=True):
        # the rows leave out points that weigh a ten thousandth
        np.testing.assert_allclose(whole, own, atol=1e-4 * np.abs(own).max())


def test_edge_nothing_kept() -> None:
    s = Surface(model())
    placed = s.at(truth())
    points, normals = scan().points[:5], scan().normals[:5]
    pairs = closest(placed, points, normals, cut_m=0.01, cosine=0.0)
    hessian, gradient = summed(placed, pairs, points, np.zeros(5))
    assert hessian.shape == (s.n, s.n)
    assert not hessian.any()
    assert not gradient.any()
