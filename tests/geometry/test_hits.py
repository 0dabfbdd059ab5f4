"""Rays on planes of known triangles against numpy's own linear solver."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

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
        flat = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        expected = flat = -flat * np.sign(flat @ rays[i])
        if normals is not None:
            expected = solved[:3] @ normals[triangles[prim[i]]]
            expected = expected * np.sign(expected @ flat)
            expected = expected - 1.001 * max(float(expected @ rays[i]), 0) * rays[i]
        assert np.allclose(out[2][i], expected / np.linalg.norm(expected), atol=1e-9)
    assert all((o[1::2] == 7.0).all() for o in out)


def test_properties_normals_at_the_outline_keep_their_side() -> None:
    """At a sphere's outline, where interpolated normals look away, they are still the sphere's."""
    ball = trimesh.creation.icosphere(3, 0.1)
    origin = np.array([0.0, 0.0, -0.4])
    vertices, triangles = np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int64)
    offset = vertices[triangles] - origin
    seen = np.einsum("ni,ni->n", ball.face_normals, offset[:, 0]) < 0
    weights = stream(4, "sample", 0, 0, "rays").dirichlet(np.ones(3), (400, len(triangles)))[
        :, seen
    ]
    rays = np.einsum("mnk,nki->mni", weights, offset[seen]).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    prim = np.tile(np.flatnonzero(seen), len(weights))
    out = np.zeros((len(rays), 3)), np.zeros(len(rays)), np.zeros((len(rays), 3))
    normals = vertices / 0.1
    meet(vertices, triangles, normals, np.arange(len(rays)), prim, origin, rays, out)
    smooth = np.einsum("nk,nki->ni", out[0], normals[triangles[prim]])
    beyond = np.einsum("ni,ni->n", smooth, rays) > 0
    assert beyond.sum() > 100
    truth = origin + out[1][:, None] * rays
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", out[2], truth).min() > np.cos(np.deg2rad(8))
    assert np.einsum("ni,ni->n", out[2], rays).max() <= 1e-12
