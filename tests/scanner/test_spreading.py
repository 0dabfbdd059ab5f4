"""What neighbours predict."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.scanner.spreading import predicted


def test_reference_plane_is_predicted_exactly() -> None:
    rows, columns = np.mgrid[0:9, 0:11].astype(np.float32)
    plane = 2 + 0.3 * 3 * columns - 0.2 * 3 * rows
    slope = np.broadcast_to(np.array([0.3, -0.2], np.float32), (9, 11, 2))
    where = np.zeros((9, 11), bool)
    where[[0, 4, 8], [0, 5, 10]] = True
    guess, lean, count = predicted(plane, slope, 3, where)
    assert guess == pytest.approx(plane[where], abs=1e-5)
    assert lean == pytest.approx(slope[where])
    assert count.tolist() == [3, 8, 3]


def test_properties_one_wrong_neighbour_does_not_count() -> None:
    plane = np.full((5, 5), 7.0, np.float32)
    plane[2, 2] = np.nan
    plane[1, 1] = 50.0
    where = np.isnan(plane)
    guess, _, count = predicted(plane, np.zeros((5, 5, 2), np.float32), 3, where)
    assert guess.tolist() == [7.0]
    assert count.tolist() == [8]


def test_edge_no_neighbour() -> None:
    lonely = np.full((3, 3), np.nan, np.float32)
    where = np.zeros((3, 3), bool)
    where[1, 1] = True
    guess, _, count = predicted(lonely, np.zeros((3, 3, 2), np.float32), 3, where)
    assert np.isnan(guess).all()
    assert count.tolist() == [0]
