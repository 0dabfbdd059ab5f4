"""Known wrong-label defects, put into what is stored: a check that misses one is broken.

The defects are those found by reading other generators, and those that formats invite. Wrong
parameters are as a generator would write them: the keypoints follow from them, too, and only what
was measured (pictures, masks, depth, scan) still shows the hand that was really there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import load_hand
from synthgen.models.joints import OPENPOSE21_FROM_MANO21, PART_FOREARM, PART_SLEEVE
from synthgen.verify.draft import Draft, ViewDraft

Points = NDArray[np.float64]
Subject = dict[str, Any]


@dataclass(frozen=True)
class Fault:
    """A defect.

    Attributes
    ----------
    change : callable
        Puts it into a sample's draft; the second draft is the next sample's.
    needs : str
        The column in which it shows: "meta", "image", "labels", "depth", "scan" or "stereo".
    absent : str
        Where it changes nothing: what the corpus would have to contain.
    witness : str
        The one check that shows it, if it is one: where that check cannot judge a sample, the
        fault is not observable there.
    """

    change: Callable[[Draft, Draft], None]
    needs: str = "meta"
    absent: str = "it changes nothing in this corpus"
    witness: str = ""


def _views(change: Callable[[ViewDraft], None]) -> Callable[[Draft, Draft], None]:
    def apply(draft: Draft, _: Draft) -> None:
        for view in draft.views:
            change(view)

    return apply


def _hands(change: Callable[[dict[str, Any]], Any]) -> Callable[[Draft, Draft], None]:
    def apply(view: ViewDraft) -> None:
        for hand in view.meta["hands"]:
            change(hand)

    return _views(apply)


def _keypoints(change: Callable[[Points], Points]) -> Callable[[Draft, Draft], None]:
    """Change the 3-D keypoints (21, 3), metres, of every hand."""
    return _hands(lambda h: h.update(keypoints_3d_m=change(np.array(h["keypoints_3d_m"])).tolist()))


def _array(
    name: str, change: Callable[[ViewDraft], NDArray[Any]]
) -> Callable[[Draft, Draft], None]:
    def apply(view: ViewDraft) -> None:
        view[name] = change(view)

    return _views(apply)


def _scan(change: Callable[[Any, Any], tuple[Any, Any]]) -> Callable[[Draft, Draft], None]:
    """Change a scan's points and normals (N, 3)."""

    def apply(draft: Draft, _: Draft) -> None:
        if draft.scan is not None:
            pair = change(draft.scan.vertices, draft.scan.normals)
            points, normals = (np.asarray(part, np.float32) for part in pair)
            draft.scan = replace(draft.scan, vertices=points, normals=normals)

    return apply


def _scan_label(
    name: str, change: Callable[[NDArray[Any]], NDArray[Any]]
) -> Callable[[Draft, Draft], None]:
    """Change one array of a scan, or of its provenance, where it has that."""

    def apply(draft: Draft, _: Draft) -> None:
        scan = draft.scan
        if scan is None or "error_m" not in scan.provenance:
            return
        if name in scan.provenance:
            told = scan.provenance | {name: change(scan.provenance[name])}
            draft.scan = replace(scan, provenance=told)
        else:
            changed: Any = {name: change(getattr(scan, name))}
            draft.scan = replace(scan, **changed)

    return apply


def _truth(change: Callable[[Subject], None]) -> Callable[[Draft, Draft], None]:
    """Change every subject's parameters; the keypoints follow."""

    def apply(draft: Draft, _: Draft) -> None:
        for view in draft.views:
            for subject, hand in zip(view.meta["spec"]["scene"]["subjects"], view.meta["hands"],
                                     strict=True):  # fmt: skip
                change(subject)
                _relabel(view.meta, subject, hand)

    return apply


def _relabel(meta: dict[str, Any], subject: Subject, hand: dict[str, Any]) -> None:
    """Compute a hand's keypoints from its parameters, as a generator does."""
    from synthgen.geometry.cameras import camera_from_K, project, to_camera

    model = load_hand(subject["model"], hand=subject["hand"])
    shape, pose, move = (np.array(subject[k])[None] for k in ("shape", "pose", "translation_m"))
    posed = model.evaluate(shape, pose, move)
    both = np.concatenate([posed.joints[0], posed.vertices[0][model.fingertip_ids]])
    keypoints = both[list(OPENPOSE21_FROM_MANO21)].astype(np.float64)
    camera = camera_from_K(np.array(meta["K"]), meta["width"], meta["height"],
                           np.array(meta["T_world_from_camera"]), meta["distortion"])  # fmt: skip
    hand["keypoints_2d"] = project(camera, keypoints)[0].tolist()
    hand["keypoints_3d_m"] = to_camera(camera, keypoints).tolist()


def _model(subject: Subject) -> Any:
    return load_hand(subject["model"], hand=subject["hand"])


def _mean(subject: Subject) -> Points:
    mean = _model(subject).hands_mean
    mean = np.full(45, 0.2) if mean is None else np.asarray(mean)
    return np.concatenate([np.zeros((1, 3)), mean.reshape(15, 3)])


def _pose(change: Callable[[Points, Subject], Points]) -> Callable[[Draft, Draft], None]:
    return _truth(lambda s: s.update(pose=change(np.array(s["pose"]), s).tolist()))


def _pca_as_angles(pose: Points, subject: Subject) -> Points:
    off = (pose - _mean(subject))[1:].ravel()
    components = _model(subject).hands_components
    if components is not None:
        off = np.linalg.lstsq(components.T, off, rcond=None)[0]
    return np.concatenate([pose[:1], off.reshape(15, 3)])


def _bend_fingers(pose: Points, _: Subject) -> Points:
    """Bend every finger, of which a picture may hide some: the mesh is older than its pose."""
    pose[1::3] += [0.0, 0.0, 0.25]
    return pose


def _about_origin(subject: Subject) -> None:
    """Turn about the origin in place of joint 0: the translation is off by J0 - R J0."""
    joint = _model(subject).shaped(np.array(subject["shape"]))[1][0]
    joint = joint if np.linalg.norm(joint) > 0.01 else np.array([0.09, 0.0, 0.01])
    turn = matrix_from_axis_angle(np.array(subject["pose"][0]))
    subject["translation_m"] = (np.array(subject["translation_m"]) + joint - turn @ joint).tolist()


def _other_tip(points: Points) -> Points:
    points[8] = 0.9 * points[8] + 0.1 * points[7]  # another vertex of the same fingertip
    return points


def _eight_bits(view: ViewDraft) -> NDArray[Any]:
    top = float(view["depth_z_m"].max())
    return np.asarray(np.rint(view["depth_z_m"] / top * 255) / 255 * top)


def _labels_mirrored(view: ViewDraft) -> None:
    for name in ("depth_z_m", "instance_id", "part_id"):
        if name in view:
            view[name] = view[name][:, ::-1]


def _fingers_relabelled(view: ViewDraft) -> NDArray[Any]:
    """Swap the parts of the two fingers that most is seen of."""
    parts, fingers = view["part_id"], np.arange(2, 17, dtype=np.uint8).reshape(5, 3)
    one, two = np.argsort([-np.isin(parts, own).sum() for own in fingers], kind="stable")[:2]
    table = np.arange(256, dtype=np.uint8)
    table[fingers[one]], table[fingers[two]] = fingers[two], fingers[one]
    return np.asarray(table[parts])


def _sleeve_as_skin(view: ViewDraft) -> NDArray[Any]:
    part = view["part_id"]
    return np.where(part == PART_SLEEVE, PART_FOREARM, part).astype(np.uint8)


def _half_pixel_K(view: ViewDraft) -> None:
    view.meta["K"][0][2] += 0.5


def _crop(view: ViewDraft) -> None:
    """Move the principal point by 12 px in every label, as after a crop, but not in the picture."""
    camera = view.meta["spec"]["scene"]["cameras"][view.meta["view"]]
    view.meta["K"][0][2] += 12
    camera["cx"] += 12
    for hand in view.meta["hands"]:
        hand["keypoints_2d"] = (np.array(hand["keypoints_2d"]) + [12.0, 0.0]).tolist()


def _things(view: ViewDraft, label: int) -> NDArray[Any]:
    """Ids with another label for all that is no hand."""
    known = view["instance_id"] <= len(view.meta["hands"])
    return np.where(known, view["instance_id"], label).astype(np.uint8)


def _all_visible(hand: dict[str, Any]) -> None:
    hand["keypoints_state"] = [2 if s else 0 for s in hand["keypoints_state"]]


def _corner_and_size(hand: dict[str, Any]) -> None:
    if hand["box_xyxy"] is not None:
        left, top, right, bottom = hand["box_xyxy"]
        hand["box_xyxy"] = [left, top, right - left + 1, bottom - top + 1]


def _other_names(view: ViewDraft) -> None:
    """Name the keypoints in MANO's order of fingers; their coordinates stay."""
    names = view.meta["keypoint_names"]
    view.meta["keypoint_names"] = [names[0], *names[5:], *names[1:5]]


def _undistorted(view: ViewDraft) -> None:
    view.meta["distortion"] = [0.0] * 5


_GL = np.array([1.0, -1.0, -1.0])
_MIRROR = np.array([-1.0, 1.0, 1.0])
_UNSCANNED = "no scanner is simulated: its scans alone have colours and know their errors"
_WORN = "nothing is worn or before the hands; see things.occluder and wear.* (hand_full)"

FAULTS: dict[str, Fault] = {
    "left and right swapped": Fault(
        _hands(lambda h: h.update(hand="left" if h["hand"] == "right" else "right"))
    ),
    "shape sign of the other hand": Fault(
        _truth(lambda s: s.update(shape=[-v for v in s["shape"]]))
    ),
    "mean pose dropped": Fault(_pose(lambda pose, s: pose - _mean(s))),
    "mean pose doubled": Fault(_pose(lambda pose, s: pose + _mean(s))),
    "PCA coefficients as axis-angle": Fault(_pose(_pca_as_angles)),
    "degrees for radians": Fault(_pose(lambda pose, s: np.rad2deg(pose))),
    # MANO: pinky comes before ring
    "pinky and ring swapped": Fault(
        _pose(lambda pose, s: pose[[*range(7), 10, 11, 12, 7, 8, 9, 13, 14, 15]])
    ),
    "pose not the one rendered": Fault(_pose(lambda pose, s: 0.8 * pose)),
    "stale mesh after a pose change": Fault(_pose(_bend_fingers)),
    "turned about the origin": Fault(_truth(_about_origin)),
    "label of the next sample": Fault(
        lambda draft, following: draft.label_as(following), witness="stale image"
    ),
    "keypoints half a pixel off": Fault(
        _hands(lambda h: h.update(keypoints_2d=(np.array(h["keypoints_2d"]) + 0.5).tolist()))
    ),
    # MANO's finger order in place of OpenPose's
    "joint order of another library": Fault(
        _keypoints(lambda points: points[[0, *range(5, 21), 1, 2, 3, 4]])
    ),
    "keypoints in millimetres": Fault(_keypoints(lambda points: 1000 * points)),
    "OpenGL axes": Fault(_keypoints(lambda points: points * _GL)),
    "another fingertip vertex": Fault(_keypoints(_other_tip)),
    "all keypoints out of frame": Fault(_hands(lambda h: h.update(keypoints_state=[0] * 21))),
    "hidden keypoints called visible": Fault(
        _hands(_all_visible), absent="no keypoint is hidden", witness="visible"
    ),
    "keypoints named in another order": Fault(_views(_other_names)),
    # as COCO has them
    "boxes as corner and size": Fault(_hands(_corner_and_size), "labels"),
    "principal point half a pixel off": Fault(_views(_half_pixel_K)),
    "intrinsics from before a crop": Fault(_views(_crop), "labels"),
    "distortion forgotten": Fault(
        _views(_undistorted), absent="no lens distorts; see optics.distortion (hand_full)"
    ),
    "depth from the near plane": Fault(
        _array("depth_z_m", lambda view: view["depth_z_m"] - 0.01), "depth"
    ),
    "distance stored as depth": Fault(_array("depth_z_m", lambda view: view.distance_m), "depth"),
    "depth quantised to 8 bits": Fault(_array("depth_z_m", _eight_bits), "depth"),
    # a step of the PNG is 0.1 mm
    "depth stored in millimetres": Fault(
        _array("depth_z_m", lambda view: view["depth_z_m"] / 10), "depth"
    ),
    "labels mirrored": Fault(_views(_labels_mirrored), "labels"),
    "mirrored image, labels not": Fault(
        _array("image", lambda view: view["image"][:, ::-1]), "image", witness="mirrored image"
    ),
    "BGR picture": Fault(
        _array("image", lambda view: view["image"][..., ::-1]), "image", witness="skin hue"
    ),
    # of a film with a half-pixel offset, or of another frame
    "ids shifted by a pixel": Fault(
        _array("instance_id", lambda view: np.roll(view["instance_id"], 1, axis=1)), "labels"
    ),
    "parts of two fingers swapped": Fault(
        _array("part_id", _fingers_relabelled), "labels", witness="parts"
    ),
    "normals away from the camera": Fault(
        _array("normals", lambda view: -view["normals"]), "labels", witness="normals"
    ),
    "barycentrics of other corners": Fault(
        _array("stored_faces", lambda view: view["stored_faces"][..., [0, 2, 1]]),
        "labels",
        witness="barycentrics",
    ),
    "texture upside down": Fault(
        _array("uv", lambda view: view["uv"] * [1, -1] + [0, 1]), "labels", witness="uv"
    ),
    "list of objects forgotten": Fault(
        _views(lambda view: view.meta.update(objects=[])), "labels", _WORN
    ),
    # as compositing does
    "objects left out of the ids": Fault(
        _array("instance_id", lambda view: _things(view, 0)), "labels", _WORN
    ),
    "masks through what covers them": Fault(
        _array("instance_id", lambda view: _things(view, 1)), "labels", _WORN
    ),
    "sleeve labelled as skin": Fault(_array("part_id", _sleeve_as_skin), "labels", _WORN),
    "scan in millimetres": Fault(_scan(lambda p, n: (1000 * p, n)), "scan"),
    "scan mirrored": Fault(_scan(lambda p, n: (p * _MIRROR, n * _MIRROR)), "scan"),
    "scan with OpenGL axes": Fault(_scan(lambda p, n: (p * _GL, n * _GL)), "scan"),
    "scan with inward normals": Fault(_scan(lambda p, n: (p, -n)), "scan"),
    "scan half a centimetre off": Fault(_scan(lambda p, n: (p + 0.003, n)), "scan"),
    "errors of a scan in millimetres": Fault(
        _scan_label("error_m", lambda error: 1000 * error), "scan", _UNSCANNED
    ),
    "errors of a scan with the other sign": Fault(
        _scan_label("error_m", lambda error: -error), "scan", _UNSCANNED
    ),
    "barycentrics of a scan of other corners": Fault(
        _scan_label("barycentric", lambda inside: inside[:, [1, 2, 0]]), "scan", _UNSCANNED
    ),
    "BGR colours of a scan": Fault(
        _scan_label("colors", lambda colours: colours[:, ::-1]), "scan", _UNSCANNED
    ),
    "texture of a scan upside down": Fault(
        _scan_label("uv", lambda uv: np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)),
        "scan",
        _UNSCANNED,
    ),
}
