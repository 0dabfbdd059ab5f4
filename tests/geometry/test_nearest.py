"""Nearest places against all distances."""

from __future__ import annotations

import numpy as np

from synthgen.geometry.nearest import nearest
from synthgen.sampling.streams import stream


def test_reference_all_distances() -> None:
    rng = stream(0, "sample", 0, 0, "nearest")
    places, points = rng.normal(size=(40, 3)), rng.normal(size=(60, 3))
    distance, index = nearest(places, points)
    every = np.linalg.norm(points[:, None] - places[None], axis=2)
    np.testing.assert_array_equal(index, every.argmin(axis=1))
    np.testing.assert_allclose(distance, every.min(axis=1))


def test_edge_out_of_reach() -> None:
    distance, index = nearest(np.zeros((3, 2)), np.array([[5.0, 0.0], [0.1, 0.0]]), 1.0)
    assert np.isinf(distance[0])
    assert index[0] == 3
    assert distance[1] == 0.1
