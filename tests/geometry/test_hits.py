"""Rays on planes of known triangles against numpy's own linear solver."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.geometry.hits import meet
from synthgen.sampling.streams import stream


@pytest.mark.parametrize("smooth", [False, True])
def test_reference_linear_solver(smooth: bool) -> None:
    """Barycentrics and distance solve o + t d = wa A + wb B + wc C with weights that sum to 1."""
    rng = stream(3, "sample", 0, 0, "rays")
    vertices, origin = rng.standard_normal((30, 3)), np.array([0.1, 0.2, -5.0])
    triangles = rng.permuted(np.tile(np.arange(30), (8, 1)), axis=1)[:, :3]
    prim = rng.integers(0, 8, 40)
    weights = rng.dirichlet(np.ones(3), 40)
    rays = np.einsum("nk,nkd->nd", weights, vertices[triangles[prim]]) - origin
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    normals = rng.standard_normal((30, 3)) if smooth else None
    out = np.full((40, 3), 7.0), np.full(40, 7.0), np.full((40, 3), 7.0)
    rows = np.arange(0, 40, 2)
    meet(vertices, triangles, normals, rows, prim, origin, rays, out)
    for i in rows:
        corners = vertices[triangles[prim[i]]]
        system = np.block([[corners.T, -rays[i][:, None]], [np.ones((1, 3)), np.zeros((1, 1))]])
        solved = np.linalg.solve(system, np.append(origin, 1.0))
        assert np.allclose(out[0][i], solved[:3], atol=1e-9)
        assert np.isclose(out[1][i], solved[3], atol=1e-9)
        if normals is None:
            expected = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        else:
            expected = solved[:3] @ normals[triangles[prim[i]]]
        expected *= -np.sign(expected @ rays[i]) / np.linalg.norm(expected)
        assert np.allclose(out[2][i], expected, atol=1e-9)
    assert all((o[1::2] == 7.0).all() for o in out)
