"""Mirroring a right hand into a left one (Embodied Hands A.1-A.5), and back.

M = diag(-1, 1, 1): points and displacements are multiplied by M, faces reversed, and a rotation R
becomes M R M, so that an axis-angle vector (x, y, z) becomes (x, -y, -z).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from synthgen.models.mano import ManoModel
from synthgen.models.surface import Arm, HandSurface

Array = NDArray[np.float64]
_POINT = np.array([-1.0, 1.0, 1.0])
_TURN = np.array([1.0, -1.0, -1.0])


def mirror_pose(pose: NDArray[np.floating]) -> Array:
    """Mirror axis-angle vectors (..., 3)."""
    result: Array = np.asarray(pose, dtype=np.float64) * _TURN
    return result


def mirror_model(model: ManoModel) -> ManoModel:
    """Return the other hand; mirroring twice gives the same arrays again."""
    k = len(model.parents) - 1
    # displacement sign times the signs of the two indices of R - I
    pose_sign = _POINT[:, None, None, None] * _POINT[:, None] * _POINT
    pose_sign = np.broadcast_to(pose_sign, (3, k, 3, 3)).reshape(3, 9 * k)
    turn = np.tile(_TURN, k)
    return replace(
        model,
        hand="left" if model.hand == "right" else "right",
        v_template=model.v_template * _POINT,
        shapedirs=model.shapedirs * _POINT[:, None],
        posedirs=model.posedirs * pose_sign,
        faces=model.faces[:, ::-1].copy(),
        hands_mean=None if model.hands_mean is None else model.hands_mean * turn,
        hands_components=(
            None if model.hands_components is None else model.hands_components * turn
        ),
        joint_axes=None if model.joint_axes is None else model.joint_axes * _TURN,
        surface=_mirror_surface(model.surface),
    )


def _mirror_surface(surface: HandSurface) -> HandSurface:
    arm = surface.arm
    mirrored = Arm(
        template=arm.template * _POINT,
        shapedirs=arm.shapedirs * _POINT[:, None],
        weights=arm.weights,
        elbow=arm.elbow * _POINT,
        elbow_shapedirs=arm.elbow_shapedirs * _POINT[:, None],
        faces=arm.faces[:, ::-1].copy(),
        end_ids=arm.end_ids,
    )
    return replace(
        surface,
        arm=mirrored,
        faces=surface.faces[:, ::-1].copy(),
        uv_faces=surface.uv_faces[:, ::-1].copy(),
    )
