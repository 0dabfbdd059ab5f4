"""Sparse joint regressor: joints as convex combinations of nearby skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]
_DIRECTIONS = 32
_SUM_WEIGHT = 3.0


def regress_joints(joints: Array, vertices: Array, candidates: int = 8) -> Array:
    """Fit rows of non-negative weights that sum to 1.

    The nearest vertices all lie on one side of a joint, so candidates are the nearest ones in
    each of 32 directions.

    Parameters
    ----------
    joints : (n, K, 3), vertices : (n, V, 3)
        Of n subjects, metres.
    candidates : int
        Per direction.

    Returns
    -------
    (K, V) float64
    """
    mean = vertices.mean(axis=0)
    directions = _fibonacci(_DIRECTIONS)
    result = np.zeros((joints.shape[1], vertices.shape[1]))
    for k in range(joints.shape[1]):
        offset = mean - joints[:, k].mean(axis=0)
        away = np.linalg.norm(offset, axis=1)
        sector = (offset / away[:, None] @ directions.T).argmax(axis=1)
        chosen = [
            members[np.argsort(away[members], kind="stable")[:candidates]]
            for members in (np.flatnonzero(sector == d) for d in range(_DIRECTIONS))
        ]
        ids = np.concatenate(chosen)
        ids = ids[away[ids] < np.sort(away[ids])[0] * 4 + 0.01]
        rows = vertices[:, ids].transpose(0, 2, 1).reshape(-1, len(ids))
        scale = _SUM_WEIGHT * np.sqrt(len(vertices))
        A = np.concatenate([rows, np.full((1, len(ids)), scale)])
        b = np.append(joints[:, k].reshape(-1), scale)
        weights, _ = nnls(A, b, maxiter=5000)
        weights[weights < 1e-3] = 0
        result[k, ids] = weights / weights.sum()
    return result


def _fibonacci(n: int) -> Array:
    z = 1 - 2 * (np.arange(n) + 0.5) / n
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
