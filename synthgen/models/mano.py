"""Hands in MANO form, with what sampling and rendering know about them.

Equations 1-4 of Embodied Hands as the official code computes them; see
:mod:`synthgen.models.model` for what all families share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.models.model import BodyModel, Hand
from synthgen.models.surface import HandSurface

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class ManoModel(BodyModel):
    """One hand in MANO form (any vertex count); family "mano", 16 joints.

    Attributes
    ----------
    hand : "left" or "right"
    joint_axes : (K, 3, 3) or None
        Per joint unit rows flexion, abduction, twist, rest frame.
    joint_range : (K, 3, 2) or None
        Radians, lowest and highest angle about each axis.
    finger_radius : (K,) metres
        Typical thickness of flesh around each joint.
    surface : HandSurface
        Hand and arm as they are drawn.
    """

    hand: Hand
    joint_axes: Array | None
    joint_range: Array | None
    finger_radius: Array
    surface: HandSurface
