"""Nearest neighbours among points, as plain arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree


def nearest(
    places: NDArray[Any], points: NDArray[Any], reach: float = np.inf
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Find for each point the nearest place.

    Parameters
    ----------
    places : (m, d) float
    points : (n, d) float
    reach : float
        Places farther away are not looked for.

    Returns
    -------
    distance : (n,) float64
        Infinite where no place is within reach.
    index : (n,) int64
        Row of ``places``; m where none is.
    """
    found: Any = cKDTree(np.asarray(places)).query(np.asarray(points), distance_upper_bound=reach)
    return np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)
