"""Skinning weights of the bodies: MakeHuman's bones merged into joints, four per vertex."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.population import BodyCut
from synthgen.cc0.skeleton import Skeleton, joint_of_bones

Array = NDArray[np.float64]
# Where the ball of the foot begins and has taken over, in shares of the way from ankle to toes.
_BALL = (0.72, 1.0)


def owners(cut: BodyCut, skeleton: Skeleton, parents: dict[str, str]) -> NDArray[np.int64]:
    """Return the row of the joint that each of the cut's bones belongs to, (M,)."""
    names = joint_of_bones(parents)
    return np.array([skeleton.nearest(names[bone]) for bone in cut.bones])


def merged_weights(
    cut: BodyCut, skeleton: Skeleton, owner: NDArray[np.int64], points: Array, joints: Array
) -> Array:
    """Merge bone weights into joint weights (S, K), symmetric, at most four, rows sum to 1.

    MakeHuman has no ball of the foot: a smooth ramp from ankle to toe joints stands for it.

    Parameters
    ----------
    points : (S, 3), joints : (K, 3)
        Mean body and extras, and rest joints, metres.
    """
    weights = np.zeros((len(points), len(skeleton.names)))
    for m, k in enumerate(owner):
        weights[:, k] += cut.bone_weights[:, m]
    for side in ("left", "right"):
        ankle, ball = skeleton.index(f"{side}_ankle"), skeleton.index(f"{side}_foot")
        along = (joints[ball] - joints[ankle]) * [1, 0, 1]
        t = (points - joints[ankle]) @ along / (along @ along)
        ramp = np.clip((t - _BALL[0]) / (_BALL[1] - _BALL[0]), 0, 1)
        moved = weights[:, ankle] * ramp * ramp * (3 - 2 * ramp)
        weights[:, ball] += moved
        weights[:, ankle] -= moved
    weights = 0.5 * (weights + weights[cut.mirror][:, skeleton.mirrored])
    return four_per_vertex(weights)


def four_per_vertex(weights: Array) -> Array:
    """Keep the four largest weights of each row, none below a thousandth, and make them sum to 1.

    A tie at the fourth place drops all that are tied, so that mirrored rows stay mirrored.
    """
    kept = np.where(weights < 1e-3, 0, weights)
    fifth = np.sort(kept, axis=1)[:, -5:-4]
    kept = np.where(kept > fifth, kept, 0)
    return np.asarray(kept / kept.sum(axis=1, keepdims=True))
