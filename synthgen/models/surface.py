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
    bones = arm_bones(model, betas, posed, np.asarray(wrist), np.asarray(elbow))
    arm = bones.carry(bones.points, model.surface.arm.weights)
    return np.concatenate([posed.vertices[0], arm.astype(np.float32)]), posed


@dataclass(frozen=True, eq=False)
class ArmBones:
    """A posed arm: carries rest points along.

    Attributes
    ----------
    points : (A, 3)
        The arm's own rest points for this shape, metres.
    root, axis : (3,)
        Wrist joint in the rest pose, and the unit direction from it to the elbow.
    length_m : float
        From wrist to elbow.
    twist : float
        Turn of the elbow about the axis, radians.
    maps : (3, 3, 4)
        Hand, forearm (without its twist) and upper arm: rest to world.
    """

    points: Array
    root: Array
    axis: Array
    length_m: float
    twist: float
    maps: Array

    def along(self, points: Array) -> Array:
        """Return how far points (n, 3) lie from the wrist along the arm, metres."""
        return np.asarray((points - self.root) @ self.axis)

    def carry(self, points: Array, weights: Array) -> Array:
        """Pose rest points (n, 3) with weights (n, 3) of the three bones.

        The forearm twists as radius and ulna do: nothing at the wrist's joint, all at the elbow,
        evenly between, so that the skin neither wrings nor steps at the wrist.
        """
        share = np.clip(self.along(points) / self.length_m, 0.0, 1.0)
        turned = self.root + _turn_about(points - self.root, self.axis, self.twist * share)
        blended = np.einsum("ab,bij->aij", weights, self.maps)
        return np.asarray(np.einsum("aij,aj->ai", blended[..., :3], turned) + blended[..., 3])


def arm_bones(model: ManoModel, betas: Array, posed: Posed, wrist: Array, elbow: Array) -> ArmBones:
    """Pose the arm's bones behind a posed hand (batch of one); arguments as :func:`pose_surface`.

    The wrist's turn is taken apart into a twist about the forearm, which the elbow takes whole,
    and the swing before it.
    """
    arm = model.surface.arm
    n = len(betas)
    hinge = arm.elbow + arm.elbow_shapedirs[..., :n] @ betas
    root = model.shaped(betas)[1][0]
    length = float(np.linalg.norm(hinge - root))
    axis = (hinge - root) / length
    swing, twist = _swing_twist(matrix_from_axis_angle(wrist), axis)
    frame = posed.transforms[0, 0]
    hand, at_wrist = frame[:3, :3], frame[:3, 3]
    fore = hand @ swing
    turned = matrix_from_axis_angle(twist * axis)
    # Points come twisted already: the upper arm takes that twist back before its own turn.
    upper = fore @ turned @ matrix_from_axis_angle(elbow) @ turned.T
    at_elbow = at_wrist + fore @ (hinge - root)
    maps = [_about(hand, root, at_wrist), _about(fore, root, at_wrist),
            _about(upper, hinge, at_elbow)]  # fmt: skip
    points = arm.template + arm.shapedirs[..., :n] @ betas
    return ArmBones(points, root, axis, length, twist, np.stack(maps))


def _swing_twist(rotation: Array, axis: Array) -> tuple[Array, float]:
    """Split a rotation into ``swing @ turn(axis, twist)``; the swing's axis is across ``axis``."""
    moved = rotation @ axis
    across = np.cross(axis, moved)
    sine, cosine = float(np.linalg.norm(across)), float(axis @ moved)
    turn = across * (np.arctan2(sine, cosine) / sine if sine > 1e-9 else 0.0)
    swing = matrix_from_axis_angle(turn)
    rest = swing.T @ rotation
    spin = np.array([rest[2, 1] - rest[1, 2], rest[0, 2] - rest[2, 0], rest[1, 0] - rest[0, 1]])
    return swing, float(np.arctan2(spin @ axis / 2, (np.trace(rest) - 1) / 2))


def _turn_about(vectors: Array, axis: Array, angle: Array) -> Array:
    """Turn vectors (n, 3) about a unit axis by an angle each (Rodrigues)."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (vectors @ axis)[:, None] * axis
    return np.asarray(along + c * (vectors - along) + s * np.cross(axis, vectors))


def _about(rotation: Array, rest: Array, placed: Array) -> Array:
    """Map (3, 4) that turns about a rest point and carries it to where it is placed."""
    return np.concatenate([rotation, (placed - rotation @ rest)[:, None]], axis=1)
