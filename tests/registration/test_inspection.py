"""Pieces of a scan, against all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from synthgen.registration.inspection import connected
from tests.registration.hands import rng, scan


@pytest.mark.parametrize("link_m", [0.004, 0.025, 0.08])
def test_reference_all_pairs(link_m: float) -> None:
    scattered = rng("pieces").uniform(-0.3, 0.3, (500, 3))
    points = np.concatenate([scan().points[:500], scattered])
    pairs = cKDTree(points).query_pairs(link_m, output_type="ndarray")
    graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), (1000, 1000))
    number, label = csgraph.connected_components(graph, directed=False)
    found = connected(points, link_m)
    assert found.max() + 1 == number
    assert len(np.unique(np.stack([found, label]), axis=1).T) == number


def test_edge_one_point() -> None:
    assert connected(np.zeros((1, 3)), 0.01).tolist() == [0]
