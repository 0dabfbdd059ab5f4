"""Body poses by joint name: the A-pose of scanning protocols, and free upright poses around it.

Spreads are Gaussian about the A-pose, folded back at the joints' ranges, so that a knee that rests
straight bends one way only. Fingers come from the pose table that the model's file carries.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, SamplingError
from synthgen.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from synthgen.models import BodyModel
from synthgen.models.hand_pca import finger_joints
from synthgen.models.joints import SIDES, swapped_side
from synthgen.sampling.body_contact import limbs_inside
from synthgen.sampling.body_limits import body_range, swing_twist

if TYPE_CHECKING:
    from synthgen.models.model import Hand

Array = NDArray[np.float64]
Spread = tuple[float, float, float]

# Degrees by which the upper arm hangs below the horizontal in an A-pose.
A_POSE_DEG = 48.0
# Standard deviations of free poses, degrees about the axes of the zero pose; left as right.
_SPREAD_DEG: Mapping[str, Spread] = {
    "spine1": (4.5, 4.5, 4.5),
    "spine2": (4.5, 4.5, 4.5),
    "spine3": (4.5, 4.5, 4.5),
    "neck": (7, 7, 7),
    "head": (8, 8, 8),
    "jaw": (2, 0.5, 0.5),
    "right_eye": (5, 8, 0),
    "right_collar": (2, 3, 3),
    "right_shoulder": (12, 20, 20),
    "right_elbow": (4, 40, 2),
    "right_wrist": (12, 10, 14),
    "right_hip": (14, 5, 6),
    "right_knee": (17, 1, 1),
    "right_ankle": (6, 3, 3),
}
MAX_TRIES, INSIDE_SHARE = 60, 0.004
# Every joint of a drawn hand is turned by about so much.
FINGER_NOISE_RAD = np.deg2rad(2.0)


@lru_cache(maxsize=8)
def _a_pose(model: BodyModel) -> Array:
    _checked(model)
    pose = np.zeros((len(model.joint_names), 3))
    for side, sign in zip(SIDES, (-1.0, 1.0), strict=True):
        pose[model.joint_names.index(f"{side}_shoulder"), 2] = sign * np.deg2rad(A_POSE_DEG)
    for side in hands_of(model):
        space = model.hand_space(side)
        if space is not None:
            pose[finger_joints(model, side)] = space.mean.reshape(15, 3)
    return pose


def a_pose(model: BodyModel) -> Array:
    """Return the A-pose (K, 3), axis-angle radians: arms half lowered, hands at their mean.

    Raises
    ------
    ModelError
        If the model is no whole body in axis-angle.
    """
    return _a_pose(model).copy()


def hands_of(model: BodyModel) -> tuple[Hand, ...]:
    """Return the sides on which a body has fingers: none for STAR."""
    return tuple(side for side in ("left", "right") if f"{side}_index1" in model.joint_names)


def sample_body_pose(
    model: BodyModel,
    spread: float = 1.0,
    *,
    rng: np.random.Generator,
    shape: NDArray[np.floating] | None = None,
) -> Array:
    """Draw a pose around the A-pose whose limbs stay out of the body, with free hands.

    Parameters
    ----------
    model : BodyModel
        A whole body in axis-angle.
    spread : float
        0: the A-pose, fingers drawn freely all the same; 0.35: a person asked to stand in it; 1:
        free standing poses.
    rng : numpy.random.Generator
    shape : (nb,) float or None
        Whose limbs must stay clear; None: the mean shape's.

    Returns
    -------
    (K, 3) float64
        Axis-angle, radians, fingers included; the root is zero (:func:`upright`).

    Raises
    ------
    SamplingError
        If ``spread`` is no number from 0 to 2, or limbs collide in all of 60 draws.
    """
    if not 0 <= spread <= 2:
        raise SamplingError(f"spread={spread}; expected 0 (the A-pose) to 2")
    betas = np.zeros(model.n_shape) if shape is None else np.asarray(shape, dtype=np.float64)
    for _ in range(MAX_TRIES):
        pose = _drawn(model, spread, rng)
        if limbs_inside(model, betas, pose) <= INSIDE_SHARE:
            return pose
    raise SamplingError(
        f"limbs lie inside the body in all of {MAX_TRIES} poses drawn with spread={spread}; "
        "use a smaller one, or a less extreme shape"
    )


def _drawn(model: BodyModel, spread: float, rng: np.random.Generator) -> Array:
    pose, names = a_pose(model), model.joint_names
    angles = np.zeros_like(pose)
    fingers = [finger_joints(model, side) for side in hands_of(model)]
    others = np.setdiff1d(np.arange(1, len(names)), np.concatenate([np.zeros(0, int), *fingers]))
    angles[others] = pose[others]
    angles += spread * np.deg2rad(spreads(model)) * rng.standard_normal(pose.shape)
    low, high = np.moveaxis(body_range(names), -1, 0)
    turned = swing_twist(names, fold(angles, low, high))
    for side, joints in zip(hands_of(model), fingers, strict=True):
        turned[joints] = sample_fingers(model, side, rng=rng)
    return turned


def spreads(model: BodyModel) -> Array:
    """Return standard deviations (K, 3) of free poses, degrees; zero for root and fingers."""
    none = (0.0, 0.0, 0.0)
    rows = [_SPREAD_DEG.get(n, _SPREAD_DEG.get(swapped_side(n), none)) for n in model.joint_names]
    return np.array(rows, dtype=np.float64)


def fold(values: Array, low: Array, high: Array) -> Array:
    """Reflect values at the ends of their ranges, as often as needed; equal ends give that end."""
    span = np.maximum(high - low, 1e-12)
    offset = np.mod(values - low, 2 * span)
    return np.asarray(low + np.where(offset > span, 2 * span - offset, offset))


def sample_fingers(model: BodyModel, side: Hand, *, rng: np.random.Generator) -> Array:
    """Draw the 15 finger joints (15, 3) of one hand, axis-angle radians, mean included.

    A row of the model's pose table, half of the time on the way to another row, every joint turned
    by about 2 degrees; a model without a table flexes all fingers together.
    """
    space = model.hand_space(side)
    noise = FINGER_NOISE_RAD * rng.standard_normal((15, 3))
    if space is None or space.coeffs is None:
        return np.asarray(noise + _flexed(side, rng))
    first, second = rng.integers(len(space.coeffs), size=2)
    share = rng.random() if rng.random() < 0.5 else 0.0
    row = (1 - share) * space.coeffs[first] + share * space.coeffs[second]
    drawn: Array = noise + (space.mean + row @ space.components[: len(row)]).reshape(15, 3)
    return drawn


def _flexed(side: Hand, rng: np.random.Generator) -> Array:
    """All fingers flexed alike, about the axis across a palm that looks down in the zero pose."""
    fingers = np.zeros((15, 3))
    flexion = np.deg2rad([70, 80, 50]) * rng.random()
    fingers[:12, 2] = (1 if side == "right" else -1) * np.tile(flexion, 4)
    return fingers


def upright(*, rng: np.random.Generator, tilt_deg: float = 3.0) -> Array:
    """Draw a root rotation (3,): any heading, tilted by about ``tilt_deg`` in each direction."""
    heading = matrix_from_axis_angle(np.array([0.0, rng.uniform(-np.pi, np.pi), 0.0]))
    lean = np.deg2rad(tilt_deg) * np.array([rng.standard_normal(), 0.0, rng.standard_normal()])
    return axis_angle_from_matrix(heading @ matrix_from_axis_angle(lean))


def _checked(model: BodyModel) -> None:
    missing = {"pelvis", "left_shoulder", "right_shoulder", "left_knee"} - set(model.joint_names)
    if missing or model.axis_meta is not None:
        why = f"lacks joints {', '.join(sorted(missing))}" if missing else "has constrained angles"
        raise ModelError(
            f"model {model.name!r} {why}; body poses are for whole bodies in axis-angle, such as "
            "cc0-body or cc0-supr"
        )
