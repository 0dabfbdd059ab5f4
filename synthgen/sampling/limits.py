"""Joint limits of the hand: decomposition into anatomical angles, checking, clamping, sampling.

A joint's rotation is ``R = Rot(flexion axis, a) Rot(abduction axis, b) Rot(twist axis, c)``, axes
fixed in the rest frame, orthonormal per joint. Ranges are normal active ranges of motion as hand
surgery tables give them (MCP 90, PIP 100, DIP 80 degrees; thumb IP 80, MCP 55, CMC 45); sources
differ by 5-20 degrees, so they are our choice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthgen.geometry.normals import unit
from synthgen.models import ManoModel

Array = NDArray[np.float64]

# Degrees (low, high) for flexion, abduction (away from the middle finger; thumb: palmar), twist.
_MCP = ((-30, 90), (-12, 20), (-4, 4))
_PIP = ((0, 100), (-2, 2), (-2, 2))
_DIP = ((-5, 80), (-2, 2), (-2, 2))
_THUMB = (
    ((-20, 45), (-10, 45), (-15, 30)),
    ((-10, 55), (-8, 8), (-3, 3)),
    ((-15, 80), (-2, 2), (-2, 2)),
)
# DIP joints follow PIP joints by a shared tendon.
_DIP_SHARE, _DIP_FREE_DEG = 0.66, 20.0


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Axes and ranges of 16 hand joints.

    Attributes
    ----------
    axes : (16, 3, 3) float64
        Per joint unit rows flexion, abduction, twist in the rest frame, orthonormal.
    range : (16, 3, 2) float64
        Radians; the root's are zero and never checked.
    """

    axes: Array
    range: Array


def limits_of(model: ManoModel) -> JointLimits:
    """Return the limits that a model's file carries, or those its rest joints imply."""
    if model.joint_axes is not None and model.joint_range is not None:
        return JointLimits(model.joint_axes, model.joint_range)
    sign = np.array([1.0, 1.0, 1.0] if model.hand == "right" else [-1.0, 1.0, 1.0])
    joints = (model.J_regressor @ model.v_template) * sign
    limits = default_limits(joints, np.array([0.25, 0.75, 0.6]))
    if model.hand == "right":
        return limits
    return JointLimits(limits.axes * np.array([1.0, -1.0, -1.0]), limits.range)


def default_limits(joints: Array, thumb_back: Array) -> JointLimits:
    """Derive axes from a flat right hand (fingers -x, back +y, thumb +z).

    Parameters
    ----------
    joints : (16, 3)
        Rest joints, metres.
    thumb_back : (3,)
        Direction out of the thumb's nail.
    """
    axes, degrees = np.tile(np.eye(3), (16, 1, 1)), np.zeros((16, 3, 2))
    for finger in range(5):
        for k in range(3):
            j = 1 + 3 * finger + k
            along = unit(joints[j + 1] - joints[j]) if k < 2 else unit(joints[j] - joints[j - 1])
            if finger == 4:
                axes[j], degrees[j] = _thumb_axes(along, k, thumb_back), _THUMB[k]
            else:
                outward = 1.0 if finger < 2 else -1.0  # index, middle: to the thumb's side
                axes[j] = _finger_axes(along, np.array([0.0, 1.0, 0.0]), outward)
                degrees[j] = (_MCP, _PIP, _DIP)[k]
    return JointLimits(axes, np.deg2rad(degrees))


def _finger_axes(along: Array, back: Array, outward: float) -> Array:
    out = unit(back - (back @ along) * along)
    return np.stack([np.cross(along, -out), outward * out, along])


def _thumb_axes(along: Array, k: int, thumb_back: Array) -> Array:
    if k > 0:
        return _finger_axes(along, thumb_back, 1.0)
    across = np.array([0.0, 0.0, -1.0])  # towards the little finger
    across = unit(across - (across @ along) * along)
    flexion = np.cross(along, across)
    abduction = np.cross(along, flexion)
    palm = np.array([0.0, -1.0, 0.0])
    abduction *= np.sign(np.cross(abduction, along) @ palm)
    return np.stack([flexion, abduction, along])


def to_angles(limits: JointLimits, pose: NDArray[np.floating]) -> Array:
    """Decompose poses (..., 16, 3) axis-angle into angles (..., 16, 3) radians."""
    theta = np.asarray(pose, dtype=np.float64)
    frame, sign = frames_of(limits)
    R = Rotation.from_rotvec(theta.reshape(-1, 3)).as_matrix().reshape(-1, 16, 3, 3)
    local = frame @ R @ frame.transpose(0, 2, 1)
    angles = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_euler("XYZ")
    return np.asarray(angles.reshape(theta.shape) * sign, dtype=np.float64)


def from_angles(limits: JointLimits, angles: NDArray[np.floating]) -> Array:
    """Compose angles (..., 16, 3) radians into poses (..., 16, 3) axis-angle."""
    given = np.asarray(angles, dtype=np.float64)
    frame, sign = frames_of(limits)
    local = Rotation.from_euler("XYZ", (given * sign).reshape(-1, 3)).as_matrix()
    R = frame.transpose(0, 2, 1) @ local.reshape(-1, 16, 3, 3) @ frame
    vectors = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(vectors.reshape(given.shape), dtype=np.float64)


def frames_of(limits: JointLimits) -> tuple[Array, Array]:
    """Return right-handed frames (16, 3, 3) and signs (16, 3) of the angles about their rows."""
    frame = limits.axes.copy()
    handed = np.sign(np.linalg.det(frame))
    frame[:, 1] *= handed[:, None]
    sign = np.ones((16, 3))
    sign[:, 1] = handed
    return frame, sign


def violation(limits: JointLimits, pose: NDArray[np.floating]) -> Array:
    """Return (..., 16, 3) radians by which each angle leaves its range; the root's are 0."""
    angles = to_angles(limits, pose)
    low, high = limits.range[..., 0], limits.range[..., 1]
    beyond = np.maximum(low - angles, angles - high)
    beyond[..., 0, :] = 0
    return np.maximum(beyond, 0.0)


def clamp(limits: JointLimits, pose: NDArray[np.floating]) -> Array:
    """Return poses (..., 16, 3) with every angle moved into its range; the root is kept."""
    angles = np.clip(to_angles(limits, pose), limits.range[..., 0], limits.range[..., 1])
    clamped = from_angles(limits, angles)
    clamped[..., 0, :] = np.asarray(pose)[..., 0, :]
    return clamped


def sample_uniform(limits: JointLimits, *, rng: np.random.Generator, n: int) -> Array:
    """Draw poses (n, 16, 3), uniform over the ranges but for two couplings of anatomy.

    A DIP joint follows its PIP joint (two thirds of it, +-20 degrees), and fingers spread less
    the more their MCP joint is flexed. The root is zero.
    """
    low, high = limits.range[..., 0], limits.range[..., 1]
    angles = low + (high - low) * rng.random((n, 16, 3))
    return from_angles(limits, couple(limits, angles, rng=rng))


def couple(limits: JointLimits, angles: Array, *, rng: np.random.Generator) -> Array:
    """Apply the two couplings to finger angles (n, 16, 3) and clip them to the ranges."""
    coupled = angles.copy()
    for mcp in (1, 4, 7, 10):
        free = np.deg2rad(rng.uniform(-_DIP_FREE_DEG, _DIP_FREE_DEG, len(angles)))
        coupled[:, mcp + 2, 0] = _DIP_SHARE * angles[:, mcp + 1, 0] + free
        coupled[:, mcp, 1] *= np.clip(np.cos(angles[:, mcp, 0]), 0.15, 1.0)
    return np.clip(coupled, limits.range[..., 0], limits.range[..., 1])
