"""From PCA coefficients of the hands to a full pose; the mean is never added silently.

Published layers differ in whether zero coefficients mean a flat hand or the mean hand, so
``flat_hand_mean`` has no default here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, ShapeError
from synthgen.models.joints import FINGERS

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel, Hand, HandSpace

Array = NDArray[np.float64]


def finger_joints(model: BodyModel, side: Hand) -> NDArray[np.int64]:
    """Return the 15 finger joints (MANO order: index, middle, pinky, ring, thumb) of a side.

    Raises
    ------
    ModelError
        If the model lacks that hand.
    """
    start = "" if model.hand == side else f"{side}_"
    wanted = [f"{start}{finger}{k}" for finger in FINGERS for k in (1, 2, 3)]
    known = {name: k for k, name in enumerate(model.joint_names)}
    if any(name not in known for name in wanted):
        raise ModelError(f"model {model.name!r} ({model.family}) has no fingers of a {side} hand")
    return np.array([known[name] for name in wanted], dtype=np.int64)


def pose_from_pca(
    model: BodyModel,
    body: NDArray[Any],
    *coefficients: NDArray[Any],
    flat_hand_mean: bool,
) -> Array:
    """Return the full pose (B, K, 3) from joints other than the fingers and hand coefficients.

    Parameters
    ----------
    model : BodyModel
        With a hand's pose space; bodies with those of both hands.
    body : (B, K - 15, 3) or (B, K - 30, 3) float
        Axis-angle, radians, of the joints that are no fingers, in the model's order. For a hand
        model that is its root alone.
    *coefficients : (B, n) float
        Of the hand; of a body's left hand, then right hand. n up to the number of components.
    flat_hand_mean : bool
        True: zero coefficients are the flat hand. False: the mean hand is added.
    """
    sides: tuple[Hand, ...] = ("left", "right") if model.hand is None else (model.hand,)
    k = len(model.parents)
    rest = np.asarray(body, dtype=np.float64)
    if len(coefficients) != len(sides):
        raise ShapeError(
            f"{len(coefficients)} sets of hand coefficients; model {model.name!r} has "
            f"{len(sides)} hands ({', '.join(sides)})"
        )
    fingers = [finger_joints(model, side) for side in sides]
    others = np.setdiff1d(np.arange(k), np.concatenate(fingers))
    if rest.ndim != 3 or rest.shape[1:] != (len(others), 3):
        raise ShapeError(f"body is {rest.shape}; expected (B, {len(others)}, 3) axis-angle")
    pose = np.zeros((len(rest), k, 3))
    pose[:, others] = rest
    for side, joints, values in zip(sides, fingers, coefficients, strict=True):
        hand = _hand(_space(model, side), np.asarray(values, dtype=np.float64), flat_hand_mean)
        if len(hand) != len(rest):
            raise ShapeError(f"{len(hand)} rows of {side} coefficients for {len(rest)} poses")
        pose[:, joints] = hand.reshape(-1, 15, 3)
    return pose


def expand_pose(model: BodyModel, vector: Any, *, flat_hand_mean: bool) -> Array:
    """Return the full pose (B, K, 3) of vectors (B, D): other joints first, then coefficients.

    SMPL+H with 6 components a hand: 66 + 6 + 6 = 78; MANO: 3 + n. Bodies have as many
    coefficients for the left as for the right hand.
    """
    values = np.asarray(vector, dtype=np.float64)
    hands = 2 if model.hand is None else 1
    fixed = 3 * (len(model.parents) - 15 * hands)
    free = values.shape[1] - fixed if values.ndim == 2 else -1
    if free < 0 or free % hands:
        raise ShapeError(
            f"pose has shape {values.shape}; with flat_hand_mean, model {model.name!r} expects "
            f"(B, {fixed} + {'2 n' if hands == 2 else 'n'}): axis-angle of the other joints, then "
            "n PCA coefficients a hand"
        )
    body = values[:, :fixed].reshape(len(values), -1, 3)
    parts = np.split(values[:, fixed:], hands, axis=1)
    return pose_from_pca(model, body, *parts, flat_hand_mean=flat_hand_mean)


def _space(model: BodyModel, side: Hand) -> HandSpace:
    space = model.hand_space(side)
    if space is None:
        raise ModelError(
            f"model {model.name!r} holds no pose space of the {side} hand; pass full axis-angle, "
            "or load the file together with the MANO pair"
        )
    return space


def _hand(space: HandSpace, coefficients: Array, flat: bool) -> Array:
    most = len(space.components)
    if coefficients.ndim != 2 or coefficients.shape[1] > most:
        raise ShapeError(f"hand coefficients are {coefficients.shape}; expected (B, n <= {most})")
    moved = coefficients @ space.components[: coefficients.shape[1]]
    return np.asarray(moved if flat else moved + space.mean)
