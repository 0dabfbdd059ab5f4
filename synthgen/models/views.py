"""From where a model is looked at in pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import unit
from synthgen.models.joints import SIDES
from synthgen.models.model import BodyModel
from synthgen.models.packed import fold_joints

Array = NDArray[np.float64]
_KNUCKLES = ("index1", "middle1", "pinky1", "ring1")


@dataclass(frozen=True, eq=False)
class View:
    """An orthonormal frame.

    Attributes
    ----------
    axes : (3, 3)
        Rows right, up and towards the viewer, in the model's frame.
    """

    axes: Array


def view_of(model: BodyModel, kind: str) -> View:
    """Return the view of a whole model, or of a part.

    Parameters
    ----------
    model : BodyModel
    kind : str
        "" the whole model (which may be a part of a body); "head"; "left" or "right" a hand.
    """
    if model.hand is not None:
        return _hand_view(model, "")
    lone = [side for side in SIDES if f"{side}_index1" in model.joint_names]
    side = kind if kind in SIDES else lone[0] if len(lone) == 1 else ""
    if side:
        return _hand_view(model, f"{side}_")
    x, y, z = np.eye(3)
    if kind == "head" or "spine1" in model.joint_names:
        return _framed(z, y)
    return _framed(0.75 * x + 0.5 * y + 0.55 * z, y)


def _hand_view(model: BodyModel, prefix: str) -> View:
    """Fingers up, seen on the back of the hand from the side of the thumb."""
    joints = dict(zip(model.joint_names, fold_joints(model)[0], strict=True))
    wrist = joints[f"{prefix}wrist"]
    fingers = unit(np.mean([joints[f"{prefix}{name}"] for name in _KNUCKLES], axis=0) - wrist)
    back = np.array([0.0, 1.0, 0.0])  # hands rest palm down
    thumb = joints[f"{prefix}thumb1"] - wrist
    sideways = np.cross(fingers, back)
    sideways *= np.sign(sideways @ thumb)
    return _framed(0.8 * back + 0.6 * sideways, fingers)


def _framed(towards: Array, up: Array) -> View:
    out = unit(towards)
    right = unit(np.cross(up, out))
    return View(np.stack([right, np.cross(out, right), out]))
