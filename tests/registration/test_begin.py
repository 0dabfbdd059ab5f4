"""Walks that begin at a matched neighbour end where a search does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synthgen.registration.begin import beginnings
from synthgen.registration.correspondences import Pairs, closest
from tests.registration.hands import rng, scan, surface, truth


def matched(start: np.ndarray | None = None, n: int = 20_000) -> Pairs:
    placed = surface().at(truth() + rng("begin").normal(0, 1e-3, surface().n))
    return closest(placed, scan().points[:n], scan().normals[:n], cut_m=0.005, cosine=0.5,
                   start=start)  # fmt: skip


def test_reference_exact_search() -> None:
    start = beginnings(scan().points, scan().normals, matched(n=4000))
    assert 0 < (start < 0).mean() < 0.2
    walked, exact = matched(start), matched()
    wrong = exact.kept & (walked.squared > exact.squared + 1e-12)
    assert wrong.sum() < 1e-3 * exact.kept.sum()


def test_properties_the_leading_points_keep_their_own() -> None:
    some = matched(n=300)
    start = beginnings(scan().points[:300], scan().normals[:300], some)
    np.testing.assert_array_equal(start, np.where(some.kept, some.corner, -1))


def test_edge_nothing_matched_is_searched() -> None:
    some = matched(n=50)
    none = replace(some, kept=np.zeros(50, bool))
    start = beginnings(scan().points[:200], scan().normals[:200], none)
    assert (start == -1).all()
    np.testing.assert_array_equal(matched(start, 200).face, matched(n=200).face)
