"""Known wrong-label defects, injected into a sample in memory: a check that misses one is broken.

The defects are those found by reading other generators, and those that formats invite.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus import Corpus
from synthgen.corpus.sample import Sample, View
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import load_hand
from synthgen.models.joints import PART_FOREARM, PART_SLEEVE
from synthgen.verify.checks import check_view
from synthgen.verify.report import VerifyReport

Points = NDArray[np.float64]
_MIRROR = np.array([-1.0, 1.0, 1.0])
NEXT_LABEL = "next label"


@dataclass(frozen=True)
class Fault:
    """A defect.

    Attributes
    ----------
    change : callable
        Puts it into a view, in memory.
    touches : str
        What it spoils: "truth" (parameters), "keypoints", "camera", "image", "labels", "depth",
        "scan" (points alone) or "next label".
    points : callable or None
        What it does to a scan's points and normals, where it touches those as well.
    """

    change: Callable[[View], None]
    touches: str
    points: Callable[[Points, Points], tuple[Points, Points]] | None = None


def _each_hand(view: View, change: Callable[[dict[str, Any]], None]) -> None:
    for hand in view.meta["hands"]:
        change(hand)


def _shift(view: View) -> None:
    _each_hand(view, lambda h: h.update(keypoints_2d=(np.array(h["keypoints_2d"]) + 0.5).tolist()))


def _order(view: View) -> None:
    order = [0, *range(5, 21), 1, 2, 3, 4]  # MANO's finger order in place of OpenPose's
    _each_hand(view, lambda h: h.update(keypoints_3d_m=[h["keypoints_3d_m"][k] for k in order]))


def _side(view: View) -> None:
    _each_hand(view, lambda h: h.update(hand="left" if h["hand"] == "right" else "right"))


def _millimetres(view: View) -> None:
    _each_hand(
        view, lambda h: h.update(keypoints_3d_m=(1000 * np.array(h["keypoints_3d_m"])).tolist())
    )


def _opengl(view: View) -> None:
    flip = np.array([1.0, -1.0, -1.0])
    _each_hand(
        view, lambda h: h.update(keypoints_3d_m=(np.array(h["keypoints_3d_m"]) * flip).tolist())
    )


def _tip(view: View) -> None:
    def change(hand: dict[str, Any]) -> None:
        points = np.array(hand["keypoints_3d_m"])
        points[8] = 0.9 * points[8] + 0.1 * points[7]  # another vertex of the same fingertip
        hand["keypoints_3d_m"] = points.tolist()

    _each_hand(view, change)


def _state(view: View) -> None:
    _each_hand(view, lambda h: h.update(keypoints_state=[0] * 21))


def _mean_pose(view: View) -> None:
    """Pose stored relative to the mean: the skeleton no longer belongs to it."""
    for subject in view.meta["spec"]["scene"]["subjects"]:
        subject["pose"] = [[0.8 * v for v in row] for row in subject["pose"]]


def _near_plane(view: View) -> None:
    view.__dict__["depth_z_m"] = view.depth_z_m - np.float32(0.01)


def _distance_as_depth(view: View) -> None:
    view.__dict__["depth_z_m"] = view.distance_m


def _mirrored(view: View) -> None:
    for name in ("depth_z_m", "instance_id", "part_id"):
        view.__dict__[name] = getattr(view, name)[:, ::-1]


def _ids_shifted(view: View) -> None:
    """Ids of a film with a half-pixel offset, or of another frame."""
    view.__dict__["instance_id"] = np.roll(view.instance_id, 1, axis=1)


def _parts_permuted(view: View) -> None:
    table = np.arange(256, dtype=np.uint8)
    table[[8, 9, 10, 11, 12, 13]] = [11, 12, 13, 8, 9, 10]  # ring and pinky swapped
    view.__dict__["part_id"] = table[view.part_id]


def _normals_away(view: View) -> None:
    view.__dict__["normals"] = -view.normals


def _uv_flipped(view: View) -> None:
    view.__dict__["uv"] = np.stack([view.uv[..., 0], 1 - view.uv[..., 1]], axis=-1)


def _bgr(view: View) -> None:
    view.__dict__["image"] = np.ascontiguousarray(view.image[..., ::-1])


def _half_pixel_K(view: View) -> None:
    view.meta["K"][0][2] += 0.5


def _each_subject(view: View, change: Callable[[dict[str, Any]], None]) -> None:
    for subject in view.meta["spec"]["scene"]["subjects"]:
        change(subject)


def _shape_sign(view: View) -> None:
    _each_subject(view, lambda s: s.update(shape=[-v for v in s["shape"]]))


def _mean_of(subject: dict[str, Any]) -> Points:
    model = load_hand(subject["model"], hand=subject["hand"])
    mean = np.full(45, 0.2) if model.hands_mean is None else model.hands_mean
    return np.concatenate([np.zeros((1, 3)), mean.reshape(15, 3)])


def _mean_times(share: float) -> Callable[[View], None]:
    """Mean pose left out (-1) or added twice (+1)."""

    def change(subject: dict[str, Any]) -> None:
        subject["pose"] = (np.array(subject["pose"]) + share * _mean_of(subject)).tolist()

    return lambda view: _each_subject(view, change)


def _pca_as_angles(view: View) -> None:
    def change(subject: dict[str, Any]) -> None:
        model = load_hand(subject["model"], hand=subject["hand"])
        pose = np.array(subject["pose"])
        off = pose[1:].ravel() - _mean_of(subject)[1:].ravel()
        if model.hands_components is not None:
            solved: Any = np.linalg.lstsq(model.hands_components.T, off, rcond=None)[0]
            off = np.asarray(solved, dtype=np.float64)
        pose[1:] = off.reshape(15, 3)
        subject["pose"] = pose.tolist()

    _each_subject(view, change)


def _degrees(view: View) -> None:
    _each_subject(view, lambda s: s.update(pose=np.rad2deg(s["pose"]).tolist()))


def _fingers_swapped(view: View) -> None:
    order = [*range(7), 10, 11, 12, 7, 8, 9, 13, 14, 15]  # MANO: pinky comes before ring
    _each_subject(view, lambda s: s.update(pose=[s["pose"][k] for k in order]))


def _stale_finger(view: View) -> None:
    """Bend one finger: the mesh is older than its pose."""

    def change(subject: dict[str, Any]) -> None:
        pose = np.array(subject["pose"])
        pose[1] += [0.0, 0.0, 0.25]
        subject["pose"] = pose.tolist()

    _each_subject(view, change)


def _about_origin(view: View) -> None:
    """Turn about the origin in place of joint 0: the translation is off by J0 - R J0."""

    def change(subject: dict[str, Any]) -> None:
        model = load_hand(subject["model"], hand=subject["hand"])
        joint = model.shaped(np.array(subject["shape"]))[1][0]
        joint = joint if np.linalg.norm(joint) > 0.01 else np.array([0.09, 0.0, 0.01])
        turn = matrix_from_axis_angle(np.array(subject["pose"][0]))
        moved = np.array(subject["translation_m"]) + joint - turn @ joint
        subject["translation_m"] = moved.tolist()

    _each_subject(view, change)


def _eight_bits(view: View) -> None:
    depth = view.depth_z_m
    top = float(depth.max())
    view.__dict__["depth_z_m"] = (np.rint(depth / top * 255) / 255 * top).astype(np.float32)


def _depth_millimetres(view: View) -> None:
    view.__dict__["depth_z_m"] = view.depth_z_m * np.float32(1000)


def _mirrored_image(view: View) -> None:
    view.__dict__["image"] = np.ascontiguousarray(view.image[:, ::-1])


def _crop(view: View) -> None:
    """Move the principal point by 12 px in every label, as after a crop, but not in the picture."""
    camera = view.meta["spec"]["scene"]["cameras"][view.meta["view"]]
    view.meta["K"][0][2] += 12
    camera["cx"] += 12
    _each_hand(
        view,
        lambda h: h.update(keypoints_2d=(np.array(h["keypoints_2d"]) + [12.0, 0.0]).tolist()),
    )


def _nothing(view: View) -> None:
    pass


def _objects_unlabelled(view: View) -> None:
    """Things before the hand left out of the ids, as compositing does."""
    known = view.instance_id <= len(view.meta["hands"])
    view.__dict__["instance_id"] = np.where(known, view.instance_id, 0).astype(np.uint8)


def _amodal(view: View) -> None:
    """Draw the hand's mask through what covers it."""
    covered = view.instance_id > len(view.meta["hands"])
    view.__dict__["instance_id"] = np.where(covered, 1, view.instance_id).astype(np.uint8)


def _sleeve_as_skin(view: View) -> None:
    view.__dict__["part_id"] = np.where(view.part_id == PART_SLEEVE, PART_FOREARM, view.part_id)


def _all_visible(view: View) -> None:
    """Occlusion by things ignored."""

    def change(hand: dict[str, Any]) -> None:
        hand["keypoints_state"] = [2 if s else 0 for s in hand["keypoints_state"]]

    _each_hand(view, change)


def _distortion_forgotten(view: View) -> None:
    view.meta["distortion"] = [0.0] * 5


# Found only where things are worn or before the hand, and the lens distorts.
OBJECT_FAULTS: dict[str, Fault] = {
    "objects left out of the ids": Fault(_objects_unlabelled, "labels"),
    "masks through what covers them": Fault(_amodal, "labels"),
    "sleeve labelled as skin": Fault(_sleeve_as_skin, "labels"),
    "hidden keypoints called visible": Fault(_all_visible, "keypoints"),
    "distortion forgotten": Fault(_distortion_forgotten, "camera"),
}

FAULTS: dict[str, Fault] = {
    "left and right swapped": Fault(_side, "keypoints"),
    "shape sign of the other hand": Fault(_shape_sign, "truth"),
    "mean pose dropped": Fault(_mean_times(-1.0), "truth"),
    "mean pose doubled": Fault(_mean_times(1.0), "truth"),
    "PCA coefficients as axis-angle": Fault(_pca_as_angles, "truth"),
    "degrees for radians": Fault(_degrees, "truth"),
    "pinky and ring swapped": Fault(_fingers_swapped, "truth"),
    "pose not the one rendered": Fault(_mean_pose, "truth"),
    "stale mesh after a pose change": Fault(_stale_finger, "truth"),
    "turned about the origin": Fault(_about_origin, "truth"),
    "label of the next sample": Fault(_nothing, NEXT_LABEL),
    "keypoints half a pixel off": Fault(_shift, "keypoints"),
    "joint order of another library": Fault(_order, "keypoints"),
    "millimetres": Fault(_millimetres, "keypoints"),
    "OpenGL axes": Fault(_opengl, "keypoints"),
    "another fingertip vertex": Fault(_tip, "keypoints"),
    "all keypoints out of frame": Fault(_state, "keypoints"),
    "depth from the near plane": Fault(_near_plane, "depth"),
    "distance stored as depth": Fault(_distance_as_depth, "depth"),
    "depth quantised to 8 bits": Fault(_eight_bits, "depth"),
    "depth in millimetres": Fault(_depth_millimetres, "depth"),
    "labels mirrored": Fault(_mirrored, "labels"),
    "mirrored image, labels not": Fault(_mirrored_image, "image"),
    "ids shifted by a pixel": Fault(_ids_shifted, "labels"),
    "parts of two fingers swapped": Fault(_parts_permuted, "labels"),
    "normals away from the camera": Fault(_normals_away, "depth"),
    "texture upside down": Fault(_uv_flipped, "labels"),
    "BGR picture": Fault(_bgr, "image"),
    "principal point half a pixel off": Fault(_half_pixel_K, "camera"),
    "intrinsics from before a crop": Fault(_crop, "camera"),
    "scan in millimetres": Fault(_nothing, "scan", lambda p, n: (1000 * p, n)),
    "scan mirrored": Fault(_nothing, "scan", lambda p, n: (p * _MIRROR, n * _MIRROR)),
    "scan with inward normals": Fault(_nothing, "scan", lambda p, n: (p, -n)),
    "scan half a centimetre off": Fault(_nothing, "scan", lambda p, n: (p + 0.003, n)),
}


def caught(corpus: Corpus, position: int, fault: Fault) -> bool:
    """Tell whether the checks fail a sample after a defect is put into it."""
    clean = corpus[position]
    view = clean.views[0]
    broken = View(copy.deepcopy(view.meta), view.stored_member)
    fault.change(broken)
    spec = type(clean.spec).from_json(broken.meta["spec"])
    report = VerifyReport()
    check_view(report, Sample(clean.index, (broken,), spec), broken)
    return not report.ok
