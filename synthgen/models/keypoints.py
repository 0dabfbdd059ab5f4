"""Keypoint sets of every model: OpenPose hands, and the 73 points of SMPL+H.

Fingertips and landmarks are vertices of the skin; libraries disagree on which, so a model names
its choice (``fingertip_set``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models.hand_pca import finger_joints
from synthgen.models.joints import (
    LANDMARK_NAMES,
    OPENPOSE21_FROM_MANO21,
    SIDES,
    SMPLH52_NAMES,
    TIP_ORDER,
)

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel, Posed

KEYPOINTS73_NAMES = (
    *SMPLH52_NAMES,
    *LANDMARK_NAMES,
    *(f"{side}_{finger}_tip" for side in SIDES for finger in TIP_ORDER),
)


def openpose21(
    model: BodyModel, posed: Posed, hand: Literal["left", "right"] | None = None
) -> NDArray[np.float32]:
    """Return the 21 keypoints of a hand in OpenPose order.

    Parameters
    ----------
    model : BodyModel
        A hand, or a body with hands; its ``fingertip_ids`` give the tips.
    posed : Posed
    hand : "left", "right" or None
        Which hand of a body; None: the only one of a hand model.

    Returns
    -------
    (B, 21, 3) float32, metres

    Raises
    ------
    ModelError
        If the model lacks that hand, or a body's hand is not named.
    """
    joints, tips = hand_points(model, hand)
    points = np.concatenate([posed.joints[:, joints], posed.vertices[:, tips]], axis=1)
    return points[:, OPENPOSE21_FROM_MANO21]


def hand_points(
    model: BodyModel, hand: Literal["left", "right"] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return 16 joint ids in MANO order and 5 fingertip vertex ids (thumb first) of a hand."""
    side = model.hand if hand is None else hand
    if side is None:
        raise ModelError(f"{model.name!r} is a body; say hand='left' or hand='right'")
    fingers = finger_joints(model, side)
    root = "wrist" if model.hand is not None else f"{side}_wrist"
    if root not in model.joint_names:
        raise ModelError(f"model {model.name!r} has no joint {root!r}; it has {model.joint_names}")
    joints = np.concatenate([[model.joint_names.index(root)], fingers])
    first = 5 * SIDES.index(side) if len(model.fingertip_ids) == 10 else 0
    tips = model.fingertip_ids[first : first + 5]
    if len(tips) != 5:
        raise ModelError(f"model {model.name!r} has no fingertips of a {side} hand")
    return joints, tips


def keypoints73(model: BodyModel, posed: Posed) -> NDArray[np.float32]:
    """Return the 73 points of SMPL+H: 52 joints, 11 landmarks, 10 fingertips.

    Their names are ``KEYPOINTS73_NAMES``. SUPR has the same points; joints are found by name.

    Parameters
    ----------
    model : BodyModel
        A whole body with hands and landmarks.
    posed : Posed

    Returns
    -------
    (B, 73, 3) float32, metres

    Raises
    ------
    ModelError
        If the model lacks a joint, the landmarks or the fingertips.
    """
    lacking = [name for name in SMPLH52_NAMES if name not in model.joint_names]
    if lacking:
        raise ModelError(
            f"model {model.name!r} ({model.family}) has no {lacking[0]!r}; the 73 keypoints need "
            "the 52 joints of SMPL+H"
        )
    if len(model.landmark_ids) != len(LANDMARK_NAMES) or len(model.fingertip_ids) != 10:
        raise ModelError(
            f"model {model.name!r} has {len(model.landmark_ids)} landmarks and "
            f"{len(model.fingertip_ids)} fingertips; the 73 keypoints need {len(LANDMARK_NAMES)} "
            "and 10. They are known for meshes of 6890 and 10475 vertices, or come in the file "
            "(landmark_ids, fingertip_ids)"
        )
    joints = [model.joint_names.index(name) for name in SMPLH52_NAMES]
    skin: list[Any] = [*model.landmark_ids, *model.fingertip_ids]
    return np.concatenate([posed.joints[:, joints], posed.vertices[:, skin]], axis=1)
