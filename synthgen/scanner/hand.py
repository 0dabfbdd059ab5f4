"""A posed hand as something to scan: cut behind the wrist, closed, in the skin's colours.

Scans refer to the drawn surface (the model's faces, subdivided); :meth:`HandSolid.on_model` says
where on the model itself a point of it lies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from synthgen.models import ManoModel, load_hand, pose_surface
from synthgen.render.sensor import LUMINANCE
from synthgen.render.skin import material
from synthgen.scanner.cap import cut_and_cap
from synthgen.scanner.segment import CropPlane, wrist_plane
from synthgen.scanner.subject import SKIN, Solid, Surface
from synthgen.scene.description import HandSubject, Vec3
from synthgen.scene.relief import relief_of
from synthgen.scene.surface import DrawnSurface

Array = NDArray[np.float64]
BEHIND_WRIST_M = 0.03


@dataclass(frozen=True, eq=False)
class HandSolid:
    """A hand to scan.

    Attributes
    ----------
    solid : Solid
        World of the subject, metres.
    drawn : DrawnSurface
    source : (F,) int64
        Drawn face of each of the solid's faces, -1 on the cap.
    corners : (F, 3, 3) float64
        Barycentrics of its corners there: the identity but along the cut.
    joints : (K, 3) float64
    """

    solid: Solid
    drawn: DrawnSurface
    source: NDArray[np.int64]
    corners: Array
    joints: Array

    @property
    def wrist(self) -> CropPlane:
        """The plane that cuts the arm off."""
        return wrist_plane(self.joints)

    def on_model(
        self, face: NDArray[Any], barycentric: NDArray[Any]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return face (n,) of the model's surface and barycentrics (n, 3); -1 on the cap.

        Faces beyond the model's own are the arm's.
        """
        drawn = self.source[face]
        whole = np.einsum("ni,nij->nj", barycentric, self.corners[face])
        parent, inside = self.drawn.parent(np.maximum(drawn, 0), whole)
        return np.where(drawn >= 0, parent, -1).astype(np.int32), inside.astype(np.float32)


def hand_solid(
    subject: HandSubject, surface: Surface = SKIN, behind_wrist_m: float = BEHIND_WRIST_M
) -> HandSolid:
    """Pose a subject's hand and make a solid of it.

    Parameters
    ----------
    subject : HandSubject
    surface : Surface
        Weight of its gloss, and its light below the skin; the grey reflectance and the roughness
        are the subject's own.
    behind_wrist_m : float
        Where the arm ends, behind joint 0.
    """
    model = load_hand(subject.model, hand=subject.hand)
    pose = np.array(subject.pose)
    points, posed = pose_surface(
        model, np.array(subject.shape), pose, np.array(subject.translation_m),
        np.array(subject.wrist), np.array(subject.elbow),
    )  # fmt: skip
    drawn = DrawnSurface.for_model(model)
    joints = np.asarray(posed.joints[0], np.float64)
    plane = wrist_plane(joints, behind_wrist_m)
    whole = drawn.refine(points, relief_of(model, subject.skin, pose))
    rgb = vertex_colours(model, drawn, subject)
    stacked = np.concatenate([whole, rgb], axis=1)
    cut = cut_and_cap(stacked, drawn.refined_faces, plane)
    place, colours = np.ascontiguousarray(cut.vertices[:, :3]), cut.vertices[:, 3:]
    grey = float(np.median(colours @ LUMINANCE))
    look = replace(surface, albedo=grey, roughness=subject.skin.roughness)
    normals = vertex_normals(place, cut.faces)
    solid = Solid(place, cut.faces, normals, look, "subject", None, colours)
    return HandSolid(solid, drawn, cut.source, cut.corners, joints)


def vertex_colours(model: ManoModel, drawn: DrawnSurface, subject: HandSubject) -> Array:
    """Linear reflectance (n, 3) of the refined vertices, from the subject's baked skin."""
    quality = "full" if subject.skin.detail else "plain"
    size = material.atlas_size(quality, 0)
    filled = material.of_skin(model, subject.skin, quality, size)
    (albedo,) = (np.asarray(v) for name, v in filled.items() if name.endswith("base_color.data"))
    column, row = np.clip((drawn.uv * [1, -1] + [0, 1]) * size, 0, size - 1).astype(np.int64).T
    colours = np.zeros((int(drawn.source.max()) + 1, 3))
    colours[drawn.source] = albedo[row, column]
    return colours


def put_in_rig(subject: HandSubject, spin_rad: float = 0.0, lean_rad: float = 0.0) -> HandSubject:
    """Return the subject moved into a rig's frame: fingers up, centred, turned about y.

    Parameters
    ----------
    subject : HandSubject
    spin_rad : float
        About the upright, after the back of a right hand, or the palm of a left one, faces +z.
    lean_rad : float
        Of the fingers from the upright, towards +x, before the spin.
    """
    R, shift = rig_from_world(subject, spin_rad, lean_rad)
    return moved_subject(subject, R, shift)


def rig_from_world(
    subject: HandSubject, spin_rad: float = 0.0, lean_rad: float = 0.0
) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and shift (3,) of :func:`put_in_rig`, ``p -> R p + shift``."""
    hand = hand_solid(subject)
    joints = hand.joints
    up = joints[[4, 7]].mean(axis=0) - joints[0]  # middle and little finger's knuckles
    across = np.cross(up, joints[1] - joints[7])
    frame = [_unit(v) for v in (up, across)]
    side = np.cross(frame[0], frame[1])
    facing = np.cross(side, frame[0])
    stand = np.stack([side, frame[0], facing])
    turn = matrix_from_axis_angle(np.array([0, spin_rad, 0.0]))
    R = turn @ matrix_from_axis_angle(np.array([0, 0, -lean_rad])) @ stand
    box = hand.solid.vertices @ R.T
    return R, -(box.min(axis=0) + box.max(axis=0)) / 2


def moved_subject(subject: HandSubject, R: Array, shift: Array) -> HandSubject:
    """Return the subject after ``p -> R p + shift``, in its own parameters."""
    model = load_hand(subject.model, hand=subject.hand)
    hinge = model.shaped(np.array(subject.shape))[1][0]
    root = R @ matrix_from_axis_angle(np.array(subject.pose[0]))
    place = R @ (hinge + np.array(subject.translation_m)) + shift - hinge
    turned = _vec3(axis_angle_from_matrix(root))
    return replace(subject, pose=(turned, *subject.pose[1:]), translation_m=_vec3(place))


def _vec3(values: Array) -> Vec3:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)
