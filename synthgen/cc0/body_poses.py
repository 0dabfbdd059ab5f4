"""Poses that teach and test the body's pose correctives, within authored ranges of motion.

Ranges are degrees about the axes of the zero pose (x to the subject's left, y up, z forward), for
the middle and the right side; left joints mirror them. They are our choice after the usual tables.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthgen.cc0.skeleton import TOES, Skeleton
from synthgen.models.joints import swapped_side

Array = NDArray[np.float64]
Range = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

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
    **{f"right_{toe}1": ((-45, 30), (-6, 6), (-4, 4)) for toe in TOES},
    **{f"right_{toe}2": ((-12, 45), (-2, 2), (-2, 2)) for toe in TOES},
}


def pose_range(skeleton: Skeleton) -> Array:
    """Return (K, 3, 2) radians; zero for the root and for fingers, which have their own model."""
    result = np.zeros((len(skeleton.names), 3, 2))
    for k, name in enumerate(skeleton.names):
        if name in _RANGE:
            result[k] = np.deg2rad(_RANGE[name])
        elif swapped_side(name) in _RANGE:
            x, y, z = np.deg2rad(_RANGE[swapped_side(name)])
            result[k] = [x, -y[::-1], -z[::-1]]
    return result


def single_turns(skeleton: Skeleton) -> Array:
    """Poses (n, K, 3) that turn one joint alone, by half and nearly all of each range."""
    rows = []
    for k, ranges in enumerate(pose_range(skeleton)):
        for axis, ends in enumerate(ranges):
            for angle in ends[np.abs(ends) > np.deg2rad(7)]:
                for share in (0.5, 0.95):
                    pose = np.zeros((len(skeleton.names), 3))
                    pose[k, axis] = share * angle
                    rows.append(pose)
    return np.array(rows)


def mixed_turns(skeleton: Skeleton, n: int, *, rng: np.random.Generator) -> Array:
    """Draw poses (n, K, 3) anywhere in the ranges; most with hanging or raised arms."""
    ranges = pose_range(skeleton)
    low, high = ranges[..., 0], ranges[..., 1]
    angles = low + (high - low) * rng.beta(1.6, 1.6, (n, *low.shape))
    calm = rng.random((n, len(low), 1)) < 0.25  # a quarter of the joints stays near rest
    angles = np.where(calm, 0.2 * angles, angles)
    kind = np.arange(n) % 4
    for side, sign in (("right", 1), ("left", -1)):
        shoulder, collar = (skeleton.index(f"{side}_{j}") for j in ("shoulder", "collar"))
        noise = np.deg2rad([25, 20, 10]) * rng.standard_normal((n, 3))
        for which, lift in ((kind < 2, 65), (kind == 2, -58)):
            near = np.deg2rad([0, 0, lift * sign]) + noise
            angles[which, shoulder] = np.clip(near, low[shoulder], high[shoulder])[which]
        angles[kind == 2, collar, 2] = np.deg2rad(rng.uniform(-28, -8, n))[kind == 2] * sign
    return _swing_twist(skeleton, angles)


def _swing_twist(skeleton: Skeleton, angles: Array) -> Array:
    """Compose rotations: twist about the limb (arms x, all others y), then swing about the rest."""
    twist = np.zeros_like(angles)
    for k, name in enumerate(skeleton.names):
        axis = 0 if name.endswith(("shoulder", "elbow", "wrist", "collar")) else 1
        twist[:, k, axis] = angles[:, k, axis]
    swing = angles - twist
    flat = [Rotation.from_rotvec(a.reshape(-1, 3)) for a in (swing, twist)]
    return np.asarray((flat[0] * flat[1]).as_rotvec().reshape(angles.shape))


# Degrees per joint of poses that everybody knows; used to test and to look at.
_KNOWN: Mapping[str, Mapping[str, tuple[float, float, float]]] = {
    "arms down": {"right_shoulder": (0, 0, 72), "left_shoulder": (0, 0, -72)},
    "arms raised": {
        "right_collar": (0, 0, -22), "left_collar": (0, 0, 22),
        "right_shoulder": (0, 0, -62), "left_shoulder": (0, 0, 62),
    },
    "walking": {
        "right_hip": (-28, 0, 0), "left_hip": (18, 0, 0), "left_knee": (28, 0, 0),
        "right_knee": (8, 0, 0), "right_ankle": (-6, 0, 0), "left_ankle": (12, 0, 0),
        "left_foot": (-22, 0, 0), "spine2": (2, 6, 0), "right_shoulder": (-20, -20, 70),
        "left_shoulder": (-20, -25, -70), "right_elbow": (0, 20, 0), "left_elbow": (0, -30, 0),
    },
    "sitting": {
        "right_hip": (-88, 0, -6), "left_hip": (-88, 0, 6), "right_knee": (88, 0, 0),
        "left_knee": (88, 0, 0), "spine1": (8, 0, 0), "right_shoulder": (0, 25, 65),
        "left_shoulder": (0, -25, -65), "right_elbow": (0, 60, 0), "left_elbow": (0, -60, 0),
    },
    "squat": {
        "right_hip": (-100, 12, -15), "left_hip": (-100, -12, 15), "right_knee": (115, 0, 0),
        "left_knee": (115, 0, 0), "right_ankle": (-22, 0, 0), "left_ankle": (-22, 0, 0),
        "spine1": (20, 0, 0), "spine2": (12, 0, 0), "right_shoulder": (0, 75, 5),
        "left_shoulder": (0, -75, -5),
    },
    "arms forward, palms up": {
        "right_shoulder": (0, 85, 0), "left_shoulder": (0, -85, 0),
        "right_wrist": (75, 0, 0), "left_wrist": (75, 0, 0),
    },
    "twist and bend": {
        "spine1": (15, 12, 5), "spine2": (12, 12, 5), "spine3": (8, 10, 5), "neck": (10, 25, 0),
        "head": (5, 25, 5), "right_elbow": (0, 110, 0), "left_elbow": (0, -90, 0),
        "right_shoulder": (30, 20, 45), "left_shoulder": (-30, -10, -30),
    },
}  # fmt: skip


def known_poses(skeleton: Skeleton) -> tuple[tuple[str, ...], Array]:
    """Return names and poses (n, K, 3) such as sitting, walking, arms raised."""
    poses = np.zeros((len(_KNOWN), len(skeleton.names), 3))
    for row, joints in zip(poses, _KNOWN.values(), strict=True):
        for name, degrees in joints.items():
            row[skeleton.index(name)] = np.deg2rad(degrees)
    return tuple(_KNOWN), _swing_twist(skeleton, poses)
