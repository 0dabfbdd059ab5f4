"""Where walks to the closest point begin: at a neighbour's, in a scan of which a part is matched.

A walk must begin on the right skin: where a finger touches the palm, the vertex nearest to a point
may be the other's. A scan point close by that faces the same way lies on the same skin, and its
match is known from the stage before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.registration.correspondences import Pairs

Array = NDArray[np.float64]
CELL_M, NORMAL_M = 0.004, 0.02
LEAST_COSINE = 0.5


def beginnings(points: Array, normals: Array, matched: Pairs) -> NDArray[np.int64]:
    """Vertices (N,) near the closest points of scan points (N, 3), -1 where none is known.

    ``matched`` are the matches of the leading points. Each point takes that of the most alike one
    in its own cell of 4 mm.
    """
    n = len(matched.kept)
    cell = np.floor((points - points.min(axis=0)) / CELL_M).astype(np.int64)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    known = np.flatnonzero(matched.kept)
    known = known[np.argsort(key[known], kind="stable")]
    out = np.full(len(points), -1, dtype=np.int64)
    out[:n][matched.kept] = matched.corner[matched.kept]
    first = np.searchsorted(key[known], key[n:])
    _alike(points, normals, key, known, first, n, matched.corner, out)
    return out


@njit(cache=True, error_model="numpy", fastmath=True)
def _alike(
    points: Any, normals: Any, key: Any, known: Any, first: Any, n: int, corner: Any, out: Any
) -> None:
    """Give the points from n on the corner of the most alike known point in their cell."""
    for i in range(n, len(points)):
        best, at = np.inf, first[i - n]
        while at < len(known) and key[known[at]] == key[i]:
            j, away, cosine = known[at], 0.0, 0.0
            for a in range(3):
                away += (points[i, a] - points[j, a]) ** 2
                cosine += normals[i, a] * normals[j, a]
            away += 2 * NORMAL_M**2 * (1 - cosine)
            if cosine > LEAST_COSINE and away < best:
                best, out[i] = away, corner[j]
            at += 1
