"""Texels as places on the skin."""

from __future__ import annotations

import numpy as np

from synthgen.models import load
from synthgen.render.skin.sites import atlas_sites
from synthgen.scene.anatomy import anatomy_of
from synthgen.scene.surface import DrawnSurface

SIZE = 256


def test_smoke_shapes() -> None:
    sites, fill = atlas_sites(load("cc0-hand"), SIZE)
    assert fill.shape == (SIZE, SIZE)
    assert fill.max() == len(sites.points) - 1
    assert len(sites.points) > 0.2 * SIZE**2
    np.testing.assert_allclose(np.linalg.norm(sites.normals, axis=1), 1, atol=1e-5)


def lookup_error(size: int) -> np.ndarray:
    """Look every render vertex up by its texture coordinates: how far is the place found?"""
    model = load("cc0-hand")
    sites, fill = atlas_sites(model, size)
    drawn, anatomy = DrawnSurface.for_model(model), anatomy_of(model)
    column = np.clip((drawn.uv[:, 0] * size).astype(int), 0, size - 1)
    row = np.clip(((1 - drawn.uv[:, 1]) * size).astype(int), 0, size - 1)
    error = np.linalg.norm(sites.points[fill[row, column]] - anatomy.points[drawn.source], axis=1)
    return np.asarray(error[anatomy.weights[drawn.source, 16] < 0.5] / sites.spacing_m)


def test_reference_texels_lie_where_their_vertices_are() -> None:
    """To a texel, which is some three times wider where the atlas is cramped; at any size."""
    for size in (256, 512):
        error = lookup_error(size)
        assert np.median(error) < 0.6
        assert np.quantile(error, 0.99) < 3.5


def test_properties_spacing_halves_with_the_size() -> None:
    model = load("cc0-hand")
    coarse, fine = (atlas_sites(model, size)[0].spacing_m for size in (128, 256))
    np.testing.assert_allclose(coarse, 2 * fine, rtol=1e-6)
    assert 0.0005 < fine < 0.004
    assert atlas_sites(model, 128)[0].width(1e-5) >= 0.5 * coarse
