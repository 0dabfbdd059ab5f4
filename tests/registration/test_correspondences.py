"""Closest points of a scan on a placed mesh."""

from __future__ import annotations

import numpy as np

from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.subdivision import InterpolatingSubdivision
from synthgen.registration.correspondences import closest
from tests.registration.hands import rng, scan, surface, truth


def test_reference_closest_points_against_brute_force() -> None:
    placed = surface().at(truth())
    points = scan().points[:20]
    pairs = closest(placed, points, scan().normals[:20], cut_m=1.0, cosine=-2.0)
    dense = rng("dense").dirichlet([1, 1, 1], 4000)
    corners = placed.vertices[surface().faces]
    for k, point in enumerate(points):
        near = np.argsort(np.linalg.norm(corners.mean(axis=1) - point, axis=1))[:60]
        candidates = np.einsum("nk,fka->fna", dense, corners[near])
        brute = np.linalg.norm(candidates - point, axis=-1).min()
        assert np.sqrt(pairs.squared[k]) <= brute + 1e-9
        assert brute - np.sqrt(pairs.squared[k]) < 3e-4


def test_properties_points_beyond_the_wrist_pull_on_nothing() -> None:
    placed = surface().at(truth())
    ring = placed.vertices[surface().rim]
    away = ring.mean(axis=0) - placed.vertices.mean(axis=0)
    stump = ring + 0.02 * away / np.linalg.norm(away)
    outward = stump - stump.mean(axis=0)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    pairs = closest(placed, stump, outward, cut_m=0.1, cosine=-2.0)
    assert pairs.rim.mean() > 0.9
    assert not pairs.kept[pairs.rim].any()


def test_reference_half_curved_is_the_smooth_surface_through_the_vertices() -> None:
    """Beside interpolating subdivision: flat triangles lie inside it, Phong's whole bulge outside.

    At 0.5 what is left is a seventh of their distance; at 0.75 it would be half.
    """
    placed = surface().at(truth())
    smooth = InterpolatingSubdivision.build(surface().faces, len(placed.vertices))
    points = smooth.apply(placed.vertices)
    normals = vertex_normals(points, smooth.faces)
    off = {}
    for curved in (0.0, 0.5, 0.75, 1.0):
        pairs = closest(placed, points, normals, cut_m=0.01, cosine=0.5, curved=curved)
        foot = np.einsum("mk,mka->ma", pairs.barycentric, placed.vertices[pairs.triangle])
        residual = np.sum((points - foot - pairs.shift) * pairs.normal, axis=1)
        off[curved] = float(residual[pairs.kept & (pairs.inner == 1)].mean())
    assert off[0.0] > 5e-5
    assert abs(off[0.5]) < off[0.0] / 7
    assert off[0.75] < -off[0.0] / 3
    assert off[1.0] < -off[0.0] / 1.3
