"""Pose blend shapes by ridge regression with the geodesic penalty of Embodied Hands, Eq. 10."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models.chain import chain, skinning_transforms
from synthgen.models.joints import MANO16_PARENTS

Array = NDArray[np.float64]
_PARENTS = np.array(MANO16_PARENTS)
# Strength of the penalty for distances in metres; any value of 30-300 does as well.
LAMBDA = 100.0


def bone_motions(poses: Array, joints: Array) -> Array:
    """Return (n, 16, 3, 4) motions of the bones of one rest hand under poses (n, 16, 3)."""
    rest = np.broadcast_to(joints, (len(poses), 16, 3))
    return skinning_transforms(chain(matrix_from_axis_angle(poses), rest, _PARENTS), rest)


def pose_feature(poses: Array) -> Array:
    """Return (n, 135): row-major R - I of the 15 finger joints."""
    return (matrix_from_axis_angle(poses[:, 1:]) - np.eye(3)).reshape(len(poses), -1)


def skinned(points: Array, weights: Array, motions: Array) -> Array:
    """Linear blend skinning of rest points (V, 3) or (n, V, 3) under (n, 16, 3, 4)."""
    blended = np.einsum("vk,nkij->nvij", weights, motions)
    moved = np.einsum("nvij,nvj->nvi", blended[..., :3], np.broadcast_to(points, (
        len(motions), *points.shape[-2:])))  # fmt: skip
    return np.asarray(moved + blended[..., 3])


def rest_offsets(targets: Array, points: Array, weights: Array, motions: Array) -> Array:
    """Pull posed targets (n, V, 3) back through skinning; offsets from the rest points."""
    blended = np.einsum("vk,nkij->nvij", weights, motions)
    back = np.linalg.solve(blended[..., :3], (targets - blended[..., 3])[..., None])[..., 0]
    return np.asarray(back - points)


def learn_posedirs(
    poses: Array, offsets: Array, regressor: Array, points: Array, faces: NDArray[np.int64]
) -> Array:
    """Fit pose blend shapes.

    Parameters
    ----------
    poses : (n, 16, 3), offsets : (n, V, 3)
        Training poses and the rest-pose offsets that they need.
    regressor : (16, V)
        Whose rows weight the geodesic distances from joint to vertex.
    points : (V, 3), faces : (F, 3)

    Returns
    -------
    (V, 3, 135) float64
    """
    feature = pose_feature(poses)
    gram, right = feature.T @ feature, np.einsum("nf,nvc->vfc", feature, offsets)
    penalty = (regressor @ geodesics(points, faces)).T[:, 1:]
    result = np.zeros((len(points), 135, 3))
    for v in range(len(points)):
        cost = LAMBDA * np.repeat(penalty[v] ** 2, 9)
        result[v] = np.linalg.solve(gram + np.diag(cost + 1e-9), right[v])
    return result.transpose(0, 2, 1)


def geodesics(points: Array, faces: NDArray[np.int64]) -> Array:
    """Shortest paths along edges between all vertices (V, V), metres."""
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    length = np.linalg.norm(points[i] - points[j], axis=1)
    graph = sparse.coo_matrix((length, (i, j)), (len(points),) * 2).tocsr()
    graph = graph.maximum(graph.T)
    return np.asarray(csgraph.dijkstra(graph, directed=False))
