"""Variation of single digits, which MakeHuman lacks: length, width and thickness per finger.

Applied to flat hands. Standard deviations are those of hand anthropometry after overall size is
taken out, a few per cent; they are our choice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import unit

Array = NDArray[np.float64]

LENGTH_SD, WIDTH_SD, THICKNESS_SD, PALM_SD = 0.045, 0.05, 0.05, 0.03
_UP = np.array([0.0, 1.0, 0.0])


def vary_digits(
    vertices: Array, joints: Array, tips: Array, weights: Array, *, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Stretch fingers and palms of flat right hands.

    Parameters
    ----------
    vertices : (n, V, 3), joints : (n, 16, 3), tips : (n, 5, 3)
        Flat hands, metres; tips in MANO finger order.
    weights : (V, 16)
        Skinning weights; they fade each change in at the finger's root.

    Returns
    -------
    vertices, joints, tips
        Changed copies.
    """
    n = len(vertices)
    out = (vertices.copy(), joints.copy(), tips.copy())
    for finger in range(5):
        length, width, thick = 1 + rng.normal(0, [LENGTH_SD, WIDTH_SD, THICKNESS_SD], (n, 3)).T
        first = 1 + 3 * finger
        bones = np.concatenate([joints[:, first : first + 3], tips[:, finger, None]], axis=1)
        own = weights[:, first : first + 3].sum(axis=1)
        of_joint = np.zeros(16)
        of_joint[first : first + 3] = 1
        of_tip = np.eye(5)[finger]
        for points, changed, share in zip(
            (vertices, joints, tips), out, (own, of_joint, of_tip), strict=True
        ):
            moved = _lengthen(points, bones, length) + _thicken(points, bones, width, thick)
            changed += share[None, :, None] * moved
    palm = 1 + rng.normal(0, PALM_SD, n)
    for changed in out:
        middle = joints[:, 4, None, 2]
        changed[..., 2] = middle + (changed[..., 2] - middle) * palm[:, None]
    return out


def _lengthen(points: Array, bones: Array, factor: Array) -> Array:
    """Displacement along three phalanges of everything beyond their heads."""
    moved = np.zeros_like(points)
    for k in range(3):
        axis = bones[:, k + 1] - bones[:, k]
        span = np.linalg.norm(axis, axis=1)[:, None]
        axis = unit(axis)[:, None]
        along = np.sum((points - bones[:, k, None]) * axis, axis=-1)
        inside = np.clip(along, 0, np.inf if k == 2 else span)
        moved += ((factor - 1)[:, None] * inside)[..., None] * axis
    return moved


def _thicken(points: Array, bones: Array, width: Array, thickness: Array) -> Array:
    """Displacement away from the digit's axis, sideways and up-down."""
    axis = unit(bones[:, 3] - bones[:, 0])[:, None]
    along = np.sum((points - bones[:, 0, None]) * axis, axis=-1, keepdims=True)
    away = points - bones[:, 0, None] - along * axis
    ramp = np.clip(along / 0.02, 0, 1)
    up = np.sum(away * _UP, axis=-1, keepdims=True) * _UP
    side = away - up
    wide, thick = (width - 1)[:, None, None], (thickness - 1)[:, None, None]
    return np.asarray(ramp * (wide * side + thick * up))
