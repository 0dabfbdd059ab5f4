"""Ranges of motion of the body's joints, and how swing and twist make a rotation of them.

Ranges are degrees about the axes of the zero pose (x to the subject's left, y up, z forward), for
the middle and the right side; left joints mirror them. They are our choice after the usual tables.
Fingers have limits of their own (:mod:`synthgen.sampling.limits`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthgen.models.joints import SUPR75_NAMES, swapped_side

Array = NDArray[np.float64]
Range = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

_TOE1, _TOE2 = ((-45, 30), (-6, 6), (-4, 4)), ((-12, 45), (-2, 2), (-2, 2))
_RANGE: Mapping[str, Range] = {
    "right_hip": ((-110, 25), (-35, 35), (-40, 20)),
    "right_knee": ((0, 135), (-8, 8), (-4, 4)),
    "right_ankle": ((-25, 45), (-15, 15), (-18, 18)),
    "right_foot": ((-45, 25), (-5, 5), (-5, 5)),
    "spine1": ((-12, 30), (-15, 15), (-12, 12)),
    "spine2": ((-12, 25), (-15, 15), (-12, 12)),
    "spine3": ((-12, 20), (-15, 15), (-12, 12)),
    "neck": ((-25, 30), (-35, 35), (-20, 20)),
    "head": ((-25, 25), (-35, 35), (-20, 20)),
    "right_collar": ((-8, 8), (-15, 22), (-28, 12)),
    "right_shoulder": ((-55, 55), (-35, 95), (-70, 80)),
    "right_elbow": ((-8, 8), (0, 140), (-5, 5)),
    "right_wrist": ((-80, 80), (-25, 25), (-65, 70)),
    "jaw": ((-2, 26), (-7, 7), (-3, 3)),
    "right_eye": ((-25, 25), (-32, 32), (0, 0)),
    **{
        name: _TOE1 if name.endswith("1") else _TOE2
        for name in SUPR75_NAMES
        if name.startswith("right_") and "toe" in name
    },
}


def body_range(names: Sequence[str]) -> Array:
    """Return (K, 3, 2) radians; zero for the root, for fingers and for unknown joints."""
    result = np.zeros((len(names), 3, 2))
    for k, name in enumerate(names):
        if name in _RANGE:
            result[k] = np.deg2rad(_RANGE[name])
        elif swapped_side(name) in _RANGE:
            x, y, z = np.deg2rad(_RANGE[swapped_side(name)])
            result[k] = [x, -y[::-1], -z[::-1]]
    return result


def swing_twist(names: Sequence[str], angles: Array) -> Array:
    """Compose rotations (..., K, 3) of angles about the axes of the zero pose.

    First the twist about the limb (arms x, all others y), then the swing about the other two axes.
    """
    twist = np.zeros_like(angles)
    for k, name in enumerate(names):
        axis = 0 if name.endswith(("shoulder", "elbow", "wrist", "collar")) else 1
        twist[..., k, axis] = angles[..., k, axis]
    swing = angles - twist
    flat = [Rotation.from_rotvec(a.reshape(-1, 3)) for a in (swing, twist)]
    return np.asarray((flat[0] * flat[1]).as_rotvec().reshape(angles.shape))
