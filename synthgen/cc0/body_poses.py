"""Poses that teach and test the body's pose correctives, within authored ranges of motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.skeleton import Skeleton
from synthgen.sampling.body_limits import body_range, swing_twist

Array = NDArray[np.float64]


def pose_range(skeleton: Skeleton) -> Array:
    """Return (K, 3, 2) radians; zero for the root and for fingers, which have their own model."""
    return body_range(skeleton.names)


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
    return swing_twist(skeleton.names, angles)


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
    "arms forward, palms out": {
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
    return tuple(_KNOWN), swing_twist(skeleton.names, poses)
