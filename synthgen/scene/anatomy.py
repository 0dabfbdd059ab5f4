"""Landmarks of a hand's rest pose, from which skin, nails and relief are laid out.

Everything is given in the frame of a right hand - wrist at the origin, fingers along -x, back +y,
thumb +z - so that left hands, which are mirrored, share every layout with right ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from synthgen.geometry.normals import unit, vertex_normals
from synthgen.models import ManoModel
from synthgen.models.joints import FINGERS, TIP_ORDER
from synthgen.scene.surface import DrawnSurface
from synthgen.scene.transfer import masks_of

Array = NDArray[np.float64]

MIRROR = np.array([-1.0, 1.0, 1.0])
_CALM_STEPS = 24
_THUMB_BACK = np.array([0.25, 0.75, 0.6])


@dataclass(frozen=True, eq=False)
class Nail:
    """Plate of a nail: an oval in the plane of two unit vectors; half lengths in metres."""

    centre: Array
    along: Array
    out: Array
    across: Array
    half_length: float
    half_width: float


@dataclass(frozen=True, eq=False)
class Finger:
    """One finger, straight in the rest pose.

    ``joints`` are its three joints, ``points`` (4, 3) they and the tip, ``back`` (3,) the unit
    direction out of its back, ``nail`` None where the mesh has none.
    """

    name: str
    joints: tuple[int, int, int]
    points: Array
    back: Array
    nail: Nail | None

    @property
    def is_thumb(self) -> bool:
        """The thumb has its joints one bone further up."""
        return self.name == "thumb"


@dataclass(frozen=True, eq=False)
class Anatomy:
    """Rest pose of a drawn surface with its landmarks; n refined, unsplit vertices.

    Attributes
    ----------
    points, normals : (n, 3)
        Metres; unit, averaged over some millimetres.
    weights : (n, 17)
        Of the 16 joints, then the arm.
    nail : (n,)
        Mask, 0..1.
    joints : (16, 3)
    fingers : tuple of Finger
        Index, middle, pinky, ring, thumb.
    """

    points: Array
    normals: Array
    weights: Array
    nail: Array
    joints: Array
    fingers: tuple[Finger, ...]

    def finger_weight(self, finger: int) -> Array:
        """Share (n,) of a finger's three joints in the skinning of each vertex."""
        return np.asarray(self.weights[:, 1 + 3 * finger : 4 + 3 * finger].sum(axis=1))


@lru_cache(maxsize=8)
def anatomy_of(model: ManoModel) -> Anatomy:
    """Find the landmarks of a model, once per process."""
    surface, drawn = model.surface, DrawnSurface.for_model(model)
    sign = np.ones(3) if model.hand == "right" else MIRROR
    rest = np.concatenate([model.v_template, surface.arm.template])
    joints = model.J_regressor @ model.v_template
    points = (drawn.refine(rest) - joints[0]) * sign
    faces = drawn.refined_faces if model.hand == "right" else drawn.refined_faces[:, ::-1]
    normals = _calm(vertex_normals(points, faces), faces)
    spread = drawn.spread(np.column_stack([_weights(model), masks_of(model)[1]]))
    weights, nail = spread[:, :17], spread[:, 17]
    local = (joints - joints[0]) * sign
    tips = (model.v_template[model.fingertip_ids] - joints[0]) * sign
    fingers = tuple(
        _finger(f, local, tips[TIP_ORDER.index(name)], points, normals, weights, nail)
        for f, name in enumerate(FINGERS)
    )
    return Anatomy(points, normals, weights, nail, local, fingers)


def _calm(normals: Array, faces: NDArray[np.int64]) -> Array:
    """Average normals over some millimetres: which way a side faces, not how it undulates."""
    n = len(normals)
    a, b = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    ring = sparse.coo_matrix((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), (n, n)).tocsr()
    count = np.asarray(ring.sum(axis=1)).ravel()
    mean = sparse.diags(1 / np.maximum(count, 1)) @ ring
    for _ in range(_CALM_STEPS):
        normals = unit(0.5 * normals + 0.5 * (mean @ normals))
    return normals


def _weights(model: ManoModel) -> Array:
    """Skinning weights (S, 17) of hand and arm; the last column is forearm and upper arm."""
    arm = model.surface.arm.weights
    n_hand = len(model.weights)
    weights = np.zeros((n_hand + len(arm), 17))
    weights[:n_hand, :16] = model.weights
    weights[n_hand:, 0], weights[n_hand:, 16] = arm[:, 0], arm[:, 1:].sum(axis=1)
    return weights


def _finger(
    number: int, joints: Array, tip: Array, points: Array, normals: Array, weights: Array,
    nail: Array,
) -> Finger:  # fmt: skip
    ids = (1 + 3 * number, 2 + 3 * number, 3 + 3 * number)
    chain = np.vstack([joints[list(ids)], tip])
    along = unit(chain[3] - chain[1])
    own = (nail > 0.4) & (weights[:, ids[2]] > 0.5)
    back = _THUMB_BACK if FINGERS[number] == "thumb" else np.array([0.0, 1.0, 0.0])
    if own.sum() >= 8:
        seen = unit(normals[own].mean(axis=0))
        back = seen if FINGERS[number] == "thumb" else back + 0.5 * seen
    back = unit(back - (back @ along) * along)
    plate = _nail(points[own], normals[own], along) if own.sum() >= 8 else None
    return Finger(FINGERS[number], ids, chain, back, plate)


def _nail(points: Array, normals: Array, along: Array) -> Nail:
    out = normals.mean(axis=0)
    out = unit(out - (out @ along) * along)
    across = np.cross(along, out)
    middle = points.mean(axis=0)
    low, high = np.quantile((points - middle) @ np.stack([along, across], axis=1), [0, 1], axis=0)
    shift = (low + high) / 2
    length, width = (high - low) / 2
    centre = middle + shift[0] * along + shift[1] * across
    return Nail(centre, along, out, across, float(length), float(width))


def flexion_rad(model: ManoModel, pose: NDArray[Any]) -> Array:
    """Return how far each joint (16,) is bent towards the palm, radians; row 0 is zero.

    The part of each joint's axis-angle about the axis across the finger, relative to the flat
    rest pose.
    """
    anatomy = anatomy_of(model)
    vectors = np.asarray(pose, dtype=np.float64)
    if model.hand == "left":
        vectors = vectors * np.array([1.0, -1.0, -1.0])
    angles = np.zeros(len(vectors))
    for finger in anatomy.fingers:
        bones = unit(np.diff(finger.points, axis=0))
        for joint, bone in zip(finger.joints, bones, strict=True):
            angles[joint] = vectors[joint] @ unit(np.cross(finger.back, bone))
    return angles
