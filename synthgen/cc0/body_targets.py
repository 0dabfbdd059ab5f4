"""Targets of the body's pose correctives: dual quaternions over MakeHuman's own bones.

Forearm, upper arm and thigh twist along their length, and bent limbs keep their volume, which
linear blend skinning of the merged joints cannot do; one relaxation takes out bulges. Only the
right half is posed: the model is symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg
from scipy.spatial.transform import Rotation

from synthgen.cc0.correctives import skinned
from synthgen.cc0.population import BodyCut
from synthgen.cc0.skeleton import Skeleton, bone_transforms, twist_joint
from synthgen.cc0.unpose import dual_quaternion_motions
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models.chain import chain, skinning_transforms

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
DAMPING = 0.02
# Pull towards the blended positions, against one unit of stiffness per edge.
STAY = 1.0


@dataclass(frozen=True, eq=False)
class RestBody:
    """A mean body and how it is skinned.

    Attributes
    ----------
    skeleton : Skeleton
    points : (V, 3), joints : (K, 3) metres
    weights : (V, K)
    owner : (M,) int
        Joint of each of the cut's bones.
    cut : BodyCut
    """

    skeleton: Skeleton
    points: Array
    joints: Array
    weights: Array
    owner: Ints
    cut: BodyCut

    @property
    def half(self) -> Ints:
        """Vertices of the right half, midline included."""
        return np.flatnonzero(self.points[:, 0] <= 1e-9)

    def motions(self, poses: Array) -> Array:
        """Return (n, K, 3, 4) maps of the joints from rest to posed."""
        return body_motions(self.skeleton, poses, self.joints)

    def targets(self, poses: Array, ids: Ints) -> Array:
        """Pose vertices (n, len(ids), 3) as they should look."""
        weights = self.cut.bone_weights[ids]
        used = np.flatnonzero(weights.any(axis=0))
        bones = tuple(self.cut.bones[m] for m in used)
        rotations = matrix_from_axis_angle(poses)
        maps = bone_transforms(self.skeleton, bones, self.owner[used], rotations, self.joints)
        weights = weights[:, used] / weights[:, used].sum(axis=1, keepdims=True)
        turns, moves = dual_quaternion_motions(weights, maps[..., :3], maps[..., 3])
        relax = _Relaxation(self.points[ids], _submesh(self.cut.faces, ids))
        return np.stack([relax.pose(q, t) for q, t in zip(turns, moves, strict=True)])

    def offsets(self, poses: Array, ids: Ints) -> Array:
        """Rest-pose offsets (n, len(ids), 3) that bring linear blend skinning to the targets.

        Damped where the blended matrix is nearly singular: where skinning collapses, no offset
        before it can help much.
        """
        blended = np.einsum("vk,nkij->nvij", self.weights[ids], self.motions(poses))
        A = blended[..., :3]
        missing = self.targets(poses, ids) - self.skin(poses, ids)
        normal = A.swapaxes(-1, -2) @ A + DAMPING * np.eye(3)
        return np.linalg.solve(normal, A.swapaxes(-1, -2) @ missing[..., None])[..., 0]

    def skin(self, poses: Array, ids: Ints, offsets: Array | None = None) -> Array:
        """Linear blend skinning of rest points, offsets (n, len(ids), 3) added before it."""
        rest = self.points[ids] if offsets is None else self.points[ids] + offsets
        return skinned(rest, self.weights[ids], self.motions(poses))

    def relevant(self, ids: Ints) -> NDArray[np.bool_]:
        """Tell which joints' turns deform each vertex (len(ids), K), beyond moving it rigidly.

        These are the joints between those that share the vertex, and the joints whose twist the
        vertex' bones share.
        """
        below = _subtrees(self.skeleton)
        held = (self.weights[ids] > 0).astype(np.float64)
        under = held @ below.T  # how many of a vertex' joints move with joint k
        result = (under > 0) & (under < held.sum(axis=1, keepdims=True))
        for m, bone in enumerate(self.cut.bones):
            joint = twist_joint(bone)
            if joint is not None:
                result[self.cut.bone_weights[ids, m] > 0.01, self.skeleton.index(joint)] = True
        result[:, 0] = False
        return np.asarray(result)


class _Relaxation:
    """One as-rigid-as-possible step from blended motions: it takes out their bulges.

    Edges are asked to be their rest edges turned by the blended rotations of their ends (the
    global step of Sorkine 2007), positions to stay near the blended ones.
    """

    def __init__(self, points: Array, faces: Ints) -> None:
        i, j = np.unique(
            np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])), axis=0
        ).T
        n, rows = len(points), np.arange(len(i))
        ones = np.ones(len(i))
        self._gradient = sparse.csr_matrix(
            (np.r_[ones, -ones], (np.r_[rows, rows], np.r_[i, j])), (len(i), n)
        )
        self._rest = points[i] - points[j]
        self._ends = (i, j)
        self._points = points
        normal = self._gradient.T @ self._gradient + STAY * sparse.eye_array(n)
        self._solve = linalg.splu(sparse.csc_matrix(normal)).solve

    def pose(self, turns: Array, moves: Array) -> Array:
        """Return (V, 3) from unit quaternions (V, 4) and translations (V, 3)."""
        blended = Rotation.from_quat(turns)
        start = blended.apply(self._points) + moves
        i, j = self._ends
        goal = 0.5 * (blended[i].apply(self._rest) + blended[j].apply(self._rest))
        return np.asarray(self._solve(self._gradient.T @ goal + STAY * start))


def _submesh(faces: Ints, ids: Ints) -> Ints:
    """Faces among the vertices ids, numbered by their place there."""
    place = np.full(faces.max() + 1, -1)
    place[ids] = np.arange(len(ids))
    local = place[faces]
    return local[(local >= 0).all(axis=1)]


def body_motions(skeleton: Skeleton, poses: Array, joints: Array) -> Array:
    """Return (n, K, 3, 4) maps from rest to posed points."""
    rest = np.broadcast_to(joints, (len(poses), *joints.shape))
    parents = np.array(skeleton.parents)
    return skinning_transforms(chain(matrix_from_axis_angle(poses), rest, parents), rest)


def _subtrees(skeleton: Skeleton) -> Array:
    """Return (K, K): 1 where the column's joint moves with the row's."""
    below = np.eye(len(skeleton.names))
    for k in reversed(range(1, len(skeleton.names))):
        below[skeleton.parents[k]] = np.maximum(below[skeleton.parents[k]], below[k])
    return below
