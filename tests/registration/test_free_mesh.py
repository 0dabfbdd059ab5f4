"""Kernels of the free mesh beside exact search, sparse matrices and a direct solver."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from synthgen.geometry.normals import vertex_normals
from synthgen.registration.free_mesh import (
    Closest,
    Quadratic,
    closest_exact,
    closest_walk,
    mesh_of,
    quadratic,
    topology,
)
from synthgen.registration.scan import scan_of
from tests.registration.hands import rng, scanned, surface, truth


def hand() -> tuple[np.ndarray, np.ndarray]:
    """Vertices a little off the truth, and scan points."""
    vertices = surface().at(truth()).vertices
    return vertices + rng("bumps").normal(0, 2e-4, vertices.shape), scan_of(*scanned()).points


def problem(points: int = 6000, **changed: Any) -> tuple[Quadratic, np.ndarray, Closest]:
    vertices, scanned_points = hand()
    mesh = mesh_of(surface())
    p = np.ascontiguousarray(scanned_points[:points])
    n = scan_of(*scanned()).normals[:points]
    at = closest_exact(mesh, vertices, p)
    settings: dict[str, float] = {
        "noise_m": 2e-4, "edge_sd_m": 1e-3, "tie_sd_m": 0.02, "sigma_m": 1e-3, "cut_m": 4e-3,
        "cosine": 0.5,
    }  # fmt: skip
    return quadratic(mesh, vertices, p, n, at, **(settings | changed)), vertices, at


def test_smoke_topology_of_a_tetrahedron() -> None:
    mesh = topology(np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]), 4)
    assert len(mesh.edges) == 6
    assert np.diff(mesh.ring_start).tolist() == [3, 3, 3, 3]
    assert np.diff(mesh.link_start).tolist() == [3, 3, 3, 3]
    assert not mesh.rim.any()
    for v in range(4):
        own = mesh.link[mesh.link_start[v] : mesh.link_start[v + 1]]
        assert all(v in mesh.edges[e] and j in mesh.edges[e] and j != v for j, e in own)


def test_reference_walks_end_where_searches_do() -> None:
    vertices, points = hand()
    mesh = mesh_of(surface())
    before = closest_exact(mesh, vertices, points)
    moved = vertices + [3e-4, -2e-4, 1e-4] + rng("step").normal(0, 1e-4, vertices.shape)
    found = closest_walk(mesh, moved, points, before.corner(mesh))
    exact = closest_exact(mesh, moved, points)
    assert (found.squared >= exact.squared * (1 - 1e-9) - 1e-15).all()
    near = exact.squared < 0.005**2
    off = np.sqrt(found.squared) - np.sqrt(exact.squared) > 1e-7
    assert off[near].mean() < 0.003
    for at in (found, exact):
        foot = np.einsum("mk,mka->ma", at.barycentric, moved[mesh.faces[at.face]])
        np.testing.assert_allclose(np.sum((foot - points) ** 2, axis=1), at.squared, atol=1e-12)


def test_reference_blocks_are_the_sparse_matrix() -> None:
    found, vertices, at = problem()
    mesh = found.mesh
    p = np.ascontiguousarray(scan_of(*scanned()).points[: len(at.face)])
    smooth = vertex_normals(vertices, mesh.faces)
    t, b = mesh.faces[at.face], at.barycentric
    n = np.einsum("mk,mka->ma", b, smooth[t])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    w = found.kept * (1e-6 / (1e-6 + at.squared)) ** 2 / 2e-4**2
    rows = np.repeat(np.arange(len(p)), 9)
    columns = (3 * t[:, :, None] + np.arange(3)).ravel()
    A = sparse.csr_matrix(
        ((b[:, :, None] * n[:, None, :]).ravel(), (rows, columns)), (len(p), 3 * len(vertices))
    )
    tie = mesh.laplacian / 1e-3**2 + sparse.eye(len(vertices)) / 0.02**2
    ties = sparse.kron(tie, sparse.eye(3))
    K = (A.T @ sparse.diags(w) @ A + ties).tocsc()
    right = A.T @ (w * np.sum(n * p, axis=1)) + ties @ vertices.ravel()
    exact = linalg.splu(K).solve(right).reshape(-1, 3)
    solved = found.solve(vertices, vertices, 1e-11, most=5000)
    np.testing.assert_allclose(solved, exact, atol=2e-8)
    rough = found.solve(vertices, vertices, 2e-6)
    assert np.sqrt(np.mean(np.sum((rough - exact) ** 2, axis=1))) < 4e-5


def test_properties_without_points_the_model_is_the_answer() -> None:
    found, vertices, _ = problem(points=30, cut_m=1e-9)
    assert not found.kept.any()
    moved = vertices + rng("guess").normal(0, 1e-3, vertices.shape)
    np.testing.assert_allclose(found.solve(vertices, moved, 1e-9, most=2000), vertices, atol=1e-7)
