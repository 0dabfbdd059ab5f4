"""Joints of the two bodies, the MakeHuman bones behind them, and how bones turn with the joints.

MakeHuman has 163 bones. Each belongs to one joint; a few of them, the twist bones of forearm,
upper arm and thigh, turn by a share of a joint's twist, which linear blend skinning of the merged
joints cannot show: that is what the body's pose correctives learn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.unpose import DIGITS
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models.joints import (
    FINGERS,
    SMPLH52_NAMES,
    SMPLH52_PARENTS,
    SUPR75_NAMES,
    SUPR75_PARENTS,
    swapped_side,
)

Array = NDArray[np.float64]

TOES = ("bigtoe", "indextoe", "middletoe", "ringtoe", "pinkytoe")
# Joint of a bone, without the side; bones that are not named follow their parent.
_OF_BONE = {
    "root": "pelvis", "spine04": "spine1", "spine03": "spine2", "spine02": "spine3",
    "neck01": "neck", "head": "head", "clavicle": "collar", "upperarm01": "shoulder",
    "lowerarm01": "elbow", "wrist": "wrist", "upperleg01": "hip", "lowerleg01": "knee",
    "foot": "ankle", "jaw": "jaw", "eye": "eye",
    **{f"finger{DIGITS[i]}-{k}": f"{f}{k}" for i, f in enumerate(FINGERS) for k in (1, 2, 3)},
    **{f"toe{d}-{k}": f"{toe}{k}" for d, toe in enumerate(TOES, 1) for k in (1, 2)},
}  # fmt: skip
# Bones that turn with part of a twist: (joint whose twist is shared, share, axis of the twist).
# A positive share adds twist of a joint further out, a negative one holds back the own joint's.
_X, _Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
_TWIST = {
    "lowerarm01": ("wrist", 0.30, _X), "lowerarm02": ("wrist", 0.75, _X),
    "upperarm01": ("shoulder", -0.65, _X), "upperarm02": ("shoulder", -0.20, _X),
    "upperleg01": ("hip", -0.60, _Y), "upperleg02": ("hip", -0.15, _Y),
}  # fmt: skip


@dataclass(frozen=True)
class Skeleton:
    """Names and tree of a body's joints, in the order of the family's files."""

    names: tuple[str, ...]
    parents: tuple[int, ...]

    def index(self, name: str) -> int:
        """Row of a joint."""
        return self.names.index(name)

    @property
    def mirrored(self) -> NDArray[np.int64]:
        """Row of every joint's counterpart on the other side."""
        return np.array([self.index(swapped_side(name)) for name in self.names])

    def nearest(self, name: str) -> int:
        """Row of the joint or, where the skeleton lacks it, of the one that stands for it."""
        if name in self.names:
            return self.index(name)
        side, _, rest = name.partition("_")
        return self.index(f"{side}_foot" if rest.rstrip("12") in TOES else "head")


SMPLH52 = Skeleton(SMPLH52_NAMES, SMPLH52_PARENTS)
SUPR75 = Skeleton(SUPR75_NAMES, SUPR75_PARENTS)


def joint_of_bones(parents: Mapping[str, str]) -> dict[str, str]:
    """Return the joint name of every bone, given the bones' parents."""
    return {bone: _joint_name(bone, parents) for bone in parents}


def _joint_name(bone: str, parents: Mapping[str, str]) -> str:
    stem, _, side = bone.partition(".")
    if stem in _OF_BONE:
        prefix = {"L": "left_", "R": "right_", "": ""}[side]
        return prefix + _OF_BONE[stem]
    if stem.startswith(("oris01", "oris02", "oris07")) or bone == "special04":
        return "jaw"  # the lower lip
    return _joint_name(parents[bone], parents)


def bone_transforms(
    skeleton: Skeleton, bones: tuple[str, ...], owner: NDArray[np.int64], rotations: Array,
    joints: Array,
) -> Array:  # fmt: skip
    """Motions of MakeHuman's bones when the skeleton's joints turn, twist shared out.

    Parameters
    ----------
    bones : tuple of str, owner : (M,) int
        Bone names and the row of the joint that each follows.
    rotations : (n, K, 3, 3)
        Local rotations of the joints.
    joints : (K, 3)
        Rest joints, metres.

    Returns
    -------
    (n, M, 3, 4) float64
        Maps from rest points to posed points.
    """
    turn, place = rotations.copy(), np.tile(joints, (len(rotations), 1, 1))
    for k, p in enumerate(skeleton.parents):
        if p >= 0:
            turn[:, k] = turn[:, p] @ rotations[:, k]
            place[:, k] = place[:, p] + turn[:, p] @ (joints[k] - joints[p])
    result = np.empty((len(rotations), len(bones), 3, 4))
    for m, (bone, k) in enumerate(zip(bones, owner, strict=True)):
        G = turn[:, k] @ _shared_twist(skeleton, bone, rotations)
        result[:, m, :, :3] = G
        result[:, m, :, 3] = place[:, k] - G @ joints[k]
    return result


def _shared_twist(skeleton: Skeleton, bone: str, rotations: Array) -> Array:
    stem, _, side = bone.partition(".")
    if stem not in _TWIST:
        return np.eye(3)
    joint, share, axis = _TWIST[stem]
    k = skeleton.index({"L": "left_", "R": "right_"}[side] + joint)
    return matrix_from_axis_angle(share * _twist(rotations[:, k], np.array(axis)))


def _twist(rotation: Array, axis: Array) -> Array:
    """Axis-angle (n, 3) of the twist about an axis in R = swing twist."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(rotation).as_quat()
    angle = 2 * np.arctan2(q[:, :3] @ axis, q[:, 3])
    return np.asarray(((angle + np.pi) % (2 * np.pi) - np.pi)[:, None] * axis)


def twist_joint(bone: str) -> str | None:
    """Name of the joint whose twist a bone shares, if any."""
    stem, _, side = bone.partition(".")
    return {"L": "left_", "R": "right_"}[side] + _TWIST[stem][0] if stem in _TWIST else None
