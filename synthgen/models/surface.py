"""Hand and arm as they are drawn: "surface" vertices are the hand's, then the arm's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.rotations import matrix_from_axis_angle

if TYPE_CHECKING:
    from synthgen.models.mano import ManoModel
    from synthgen.models.model import Posed

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arm:
    """Forearm and upper arm behind a hand, straight in the rest pose.

    Attributes
    ----------
    template : (A, 3) metres
        Rest pose, in the hand's frame, without the wrist ring (that is the hand's).
    shapedirs : (A, 3, nb)
    weights : (A, 3)
        Hand root, forearm, upper arm; rows sum to 1.
    elbow : (3,) and elbow_shapedirs : (3, nb)
        The elbow's position in the rest pose.
    faces : (Fa, 3) int64
        Into the surface's vertices.
    end_ids : (E,) int64
        Surface vertices around the open far end.
    """

    template: Array
    shapedirs: Array
    weights: Array
    elbow: Array
    elbow_shapedirs: Array
    faces: NDArray[np.int64]
    end_ids: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class HandSurface:
    """What a hand model lacks and a picture needs.

    Attributes
    ----------
    arm : Arm
    faces : (F + Fa, 3) int64
        The model's faces, then the arm's.
    uv : (U, 2) in [0, 1], origin bottom left
    uv_faces : (F + Fa, 3) int64
    mask_nail, mask_palm : (S,) in [0, 1]
    part_of_vertex : (S,) uint8
        1-16 the hand's joints in MANO order, 17 the arm.
    """

    arm: Arm
    faces: NDArray[np.int64]
    uv: Array
    uv_faces: NDArray[np.int64]
    mask_nail: Array
    mask_palm: Array
    part_of_vertex: NDArray[np.uint8]

    @property
    def n_hand_vertices(self) -> int:
        """Number of the hand's own vertices, which come first."""
        return len(self.part_of_vertex) - len(self.arm.template)


def pose_surface(
    model: ManoModel,
    shape: NDArray[Any],
    pose: NDArray[Any],
    translation: NDArray[Any],
    wrist: NDArray[Any],
    elbow: NDArray[Any],
) -> tuple[NDArray[np.float32], Posed]:
    """Pose one hand together with its arm.

    Parameters
    ----------
    model : ManoModel
    shape : (nb,) float
    pose : (K, 3) float
        As :meth:`ManoModel.evaluate`.
    translation : (3,) float, metres
    wrist : (3,) float
        Axis-angle of the forearm relative to the hand, about joint 0, in the hand's rest frame.
    elbow : (3,) float
        Axis-angle of the upper arm relative to the forearm, about the elbow.

    Returns
    -------
    surface : (S, 3) float32
        Hand vertices (equal to the model's), then arm vertices; world, metres.
    posed : Posed
        The hand, batch of one.
    """
    betas = np.asarray(shape, dtype=np.float64)
    posed = model.evaluate(betas[None], np.asarray(pose)[None], np.asarray(translation)[None])
    points, bones = _arm_bones(model, betas, posed, np.asarray(wrist), np.asarray(elbow))
    blended = np.einsum("ab,bij->aij", model.surface.arm.weights, bones)
    arm = np.einsum("aij,aj->ai", blended[..., :3], points) + blended[..., 3]
    return np.concatenate([posed.vertices[0], arm.astype(np.float32)]), posed


def _arm_bones(
    model: ManoModel, betas: Array, posed: Posed, wrist: Array, elbow: Array
) -> tuple[Array, Array]:
    """Rest points (A, 3) of the arm and the (3, 3, 4) maps of its three bones."""
    arm = model.surface.arm
    n = len(betas)
    points = arm.template + arm.shapedirs[..., :n] @ betas
    hinge = arm.elbow + arm.elbow_shapedirs[..., :n] @ betas
    root_joint = model.shaped(betas)[1][0]
    frame = posed.transforms[0, 0]
    hand = frame[:3, :3]
    fore = hand @ matrix_from_axis_angle(wrist)
    upper = fore @ matrix_from_axis_angle(elbow)
    at_wrist = frame[:3, 3]
    at_elbow = at_wrist + fore @ (hinge - root_joint)
    return points, np.stack(
        [
            _about(hand, root_joint, at_wrist),
            _about(fore, root_joint, at_wrist),
            _about(upper, hinge, at_elbow),
        ]
    )


def _about(rotation: Array, rest: Array, placed: Array) -> Array:
    """Map (3, 4) that turns about a rest point and carries it to where it is placed."""
    return np.concatenate([rotation, (placed - rotation @ rest)[:, None]], axis=1)
