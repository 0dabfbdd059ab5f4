"""Pose correctives of whole bodies, sparse by construction, in both families' forms.

A vertex may depend on the few joints that deform it. SMPL+H form: ridge regression on ``R - I``
with the geodesic penalty of Embodied Hands, Eq. 10. SUPR form (Eq. 3): per joint a term
``relu(A_j) K_j q_j`` of quaternion features with an L1 cost on the activations ``A_j``; the
neighbours of Eq. 3 have terms of their own, which sum to the same functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from synthgen.geometry.rotations import matrix_from_axis_angle

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LAMBDA = 1
# Root mean square of a joint's term over the training poses below which it is dropped, metres.
ACTIVATION_COST_M = 3e-5
_SWEEPS = 12


def rotation_feature(poses: Array) -> Array:
    """Return (n, K, 9): row-major R - I per joint."""
    return np.asarray((matrix_from_axis_angle(poses) - np.eye(3)).reshape(*poses.shape[:2], 9))


def learn_ridge(feature: Array, offsets: Array, relevant: NDArray[np.bool_], cost: Array) -> Array:
    """Fit correctives with a quadratic cost per joint and vertex.

    Parameters
    ----------
    feature : (n, K, b), offsets : (n, V, 3) metres
    relevant : (V, K) bool
    cost : (V, K)
        Geodesic distances of Eq. 10, metres.

    Returns
    -------
    (V, K, 3, b) float64
    """
    n, k, b = feature.shape
    result = np.zeros((relevant.shape[0], k, 3, b))
    for joints, members in _groups(relevant):
        F = feature[:, joints].reshape(n, -1)
        penalty = LAMBDA * np.repeat(cost[np.ix_(members, joints)] ** 2, b, axis=1) + 1e-6
        normal = F.T @ F + penalty[:, :, None] * np.eye(F.shape[1])
        right = np.einsum("nf,nvc->vfc", F, offsets[:, members])
        solved = np.linalg.solve(normal, right).reshape(len(members), len(joints), b, 3)
        result[np.ix_(members, joints)] = solved.transpose(0, 1, 3, 2)
    return result


def learn_activations(
    feature: Array, offsets: Array, relevant: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Fit correctives with an L1 cost on their activations, by block coordinate descent.

    A joint's activation at a vertex is ``relu(c - tau)``: ``c`` is the root mean square of its
    term over the poses, ``tau`` the cost. Terms below it vanish exactly.

    Parameters
    ----------
    feature : (n, K, b), offsets : (n, V, 3) metres
    relevant : (V, K) bool

    Returns
    -------
    posedirs : (V, K, 3, b) float64
        Activations multiplied in, as in the files.
    activations : (V, K) float64, metres
    """
    n, k, b = feature.shape
    result = np.zeros((relevant.shape[0], k, 3, b))
    activations = np.zeros(relevant.shape)
    for joints, members in _groups(relevant):
        target = offsets[:, members].reshape(n, -1)
        terms = np.zeros((len(joints), b, target.shape[1]))
        active = np.zeros((len(joints), len(members)))
        left = target.copy()
        pull = [_pseudo_inverse(feature[:, j]) for j in joints]
        for _ in range(_SWEEPS if len(joints) > 1 else 1):
            for i, j in enumerate(joints):
                left += feature[:, j] @ terms[i]
                fit = pull[i] @ left
                moved = (feature[:, j] @ fit).reshape(n, -1, 3)
                size = np.sqrt(np.mean(np.sum(moved**2, axis=2), axis=0))
                active[i] = np.maximum(size - ACTIVATION_COST_M, 0)
                terms[i] = fit * np.repeat(active[i] / np.maximum(size, 1e-12), 3)
                left -= feature[:, j] @ terms[i]
        blocks = terms.reshape(len(joints), b, len(members), 3).transpose(2, 0, 3, 1)
        result[np.ix_(members, joints)] = blocks
        activations[np.ix_(members, joints)] = active.T
    return result, activations


def _pseudo_inverse(F: Array) -> Array:
    gram = F.T @ F
    return np.linalg.solve(gram + 1e-6 * np.trace(gram) * np.eye(len(gram)), F.T)


def _groups(relevant: NDArray[np.bool_]) -> list[tuple[Ints, Ints]]:
    """Group vertices: sets of joints and the vertices that depend on exactly these."""
    kinds, kind = np.unique(relevant, axis=0, return_inverse=True)
    found = [
        (np.flatnonzero(row), np.flatnonzero(kind.ravel() == i)) for i, row in enumerate(kinds)
    ]
    return [(joints, members) for joints, members in found if len(joints)]


def joint_geodesics(points: Array, faces: Ints, regressor: Array, ids: Ints) -> Array:
    """Eq. 10: geodesic distances from joints to vertices, (len(ids), K), metres.

    The distance to a joint is the mean, by its regressor's row, over the vertices that define it.
    """
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    length = np.linalg.norm(points[i] - points[j], axis=1)
    graph = sparse.coo_matrix((length, (i, j)), (len(points),) * 2).tocsr()
    graph = graph.maximum(graph.T)
    used = np.flatnonzero(regressor.any(axis=0))
    away = csgraph.dijkstra(graph, directed=False, indices=used)[:, ids]
    return np.asarray((regressor[:, used] @ away).T)


def mirror_blocks(half: Array, ids: Ints, mirror: Ints, joint_mirror: Ints) -> Array:
    """Complete correctives of the right half to a symmetric body.

    Parameters
    ----------
    half : (len(ids), K, 3, b)
        Of the vertices ``ids``; b is 9 (rotation features) or 4 (quaternions).
    mirror : (V,), joint_mirror : (K,)

    Returns
    -------
    (V, K, 3, b) float64
    """
    point, turn = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0, 1.0])
    sign = np.outer(point, point).ravel() if half.shape[3] == 9 else turn
    result = np.zeros((len(mirror), *half.shape[1:]))
    result[ids] = half
    other = half[:, joint_mirror] * point[:, None] * sign
    middle = mirror[ids] == ids
    result[mirror[ids]] = np.where(middle[:, None, None, None], 0.5 * (half + other), other)
    return result
