"""Known wrong-label defects, injected into a sample in memory: a check that misses one is broken.

The defects are those found by reading other generators, and those that formats invite.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from synthgen.corpus import Corpus, open_corpus
from synthgen.corpus.sample import Sample, View
from synthgen.models.joints import PART_FOREARM, PART_SLEEVE
from synthgen.verify.checks import check_view
from synthgen.verify.report import VerifyReport

Fault = Callable[[View], None]


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
    "objects left out of the ids": _objects_unlabelled,
    "masks through what covers them": _amodal,
    "sleeve labelled as skin": _sleeve_as_skin,
    "hidden keypoints called visible": _all_visible,
    "distortion forgotten": _distortion_forgotten,
}

FAULTS: dict[str, Fault] = {
    "keypoints half a pixel off": _shift,
    "joint order of another library": _order,
    "left and right swapped": _side,
    "millimetres": _millimetres,
    "OpenGL axes": _opengl,
    "another fingertip vertex": _tip,
    "all keypoints out of frame": _state,
    "pose not the one rendered": _mean_pose,
    "depth from the near plane": _near_plane,
    "distance stored as depth": _distance_as_depth,
    "labels mirrored": _mirrored,
    "ids shifted by a pixel": _ids_shifted,
    "parts of two fingers swapped": _parts_permuted,
    "normals away from the camera": _normals_away,
    "texture upside down": _uv_flipped,
    "BGR picture": _bgr,
    "principal point half a pixel off": _half_pixel_K,
}


def caught(corpus: Corpus, position: int, fault: Fault) -> bool:
    """Tell whether the checks fail a sample after a defect is put into it."""
    clean = corpus[position]
    view = clean.views[0]
    broken = View(copy.deepcopy(view.meta), view.stored_member)
    fault(broken)
    spec = type(clean.spec).from_json(broken.meta["spec"])
    report = VerifyReport()
    check_view(report, Sample(clean.index, (broken,), spec), broken)
    return not report.ok


def self_test(path: str | Path, samples: int = 4) -> dict[str, float]:
    """Inject every defect into some samples; return the share of samples that catch each."""
    corpus = open_corpus(path)
    chosen = range(min(samples, len(corpus)))
    return {
        name: float(np.mean([caught(corpus, k, fault) for k in chosen]))
        for name, fault in FAULTS.items()
    }
