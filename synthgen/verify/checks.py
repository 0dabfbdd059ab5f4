"""The checks: each recomputes labels of one view from the stored truth, by other means.

Other means: the model's float64 reference instead of its fast kernels, a z-buffer rasteriser
instead of Mitsuba, plain matrix products instead of the camera code that the renderer used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.columns import DEPTH_STEP_M
from synthgen.corpus.sample import HandView, Sample, Subject, View
from synthgen.geometry.cameras import Camera
from synthgen.models.joints import OPENPOSE21_FROM_MANO21, OPENPOSE21_JOINT, PART_FOREARM
from synthgen.sampling.limits import limits_of, violation
from synthgen.scene.instances import objects_of
from synthgen.scene.surface import DrawnSurface
from synthgen.verify.facts import check_exr, check_facts
from synthgen.verify.picture import check_image
from synthgen.verify.redraw import Layer, Redrawn, layers, pierced, redraw
from synthgen.verify.report import Record, VerifyReport

Array = NDArray[np.float64]

REPROJECTION_PX, KEYPOINT_3D_M = 0.05, 2e-5
MASK_SHARE = 0.001  # of silhouette pixels
DEPTH_M = DEPTH_STEP_M / 2 + 2e-5
UV, LIMIT_RAD = 2e-3, 1e-4
BARYCENTRIC = 0.005
SENSOR_SHARE = 0.02  # what makers of such cameras promise
FEWEST_SMOOTH = 50
UNDRAWN = "no pixel shows a face of the hand as rasterised"
BONE_M = (0.05, 0.13)
# Thickest flesh on the way to a joint, over the typical radius there; and before a fingertip.
FLESH, TIP_M = 2.2, 0.004
# Visibility is not judged so near to a rim, or to what flesh reaches.
RIM_PX, RIM_M = 0.05, 3e-4
_CROSS = np.array([[0.0, 0.0], [1, 0], [-1, 0], [0, 1], [0, -1]])


def check_view(report: VerifyReport, sample: Sample, view: View) -> None:
    """Run every check of one view that what is stored allows; the report counts what it lacks."""
    camera = sample.spec.scene.cameras[view.meta["view"]]
    rays = Rays(layers(sample, camera), camera)
    again = redraw(rays.layers, camera)
    record = Record(report, sample.index, view.meta["view"])
    check_camera(record, sample, view)
    check_keypoints(record, sample, view, rays)
    check_facts(record, sample, view)
    for column in ("image", "depth", "labels"):
        if column not in view.columns:
            report.lacking[column] = report.lacking.get(column, 0) + 1
    if "exr" in view.columns:
        check_exr(record, view)
    if "labels" not in view.columns:
        return
    check_masks(record, sample, view, again)
    check_surface(record, sample, view, again)
    if "depth" in view.columns:
        check_depth(record, view, again)
    if "image" in view.columns:
        check_image(record, sample, view, again)


def check_camera(record: Record, sample: Sample, view: View) -> None:
    """Check that the stored calibration equals the spec's and its rotation is one."""
    camera = sample.spec.scene.cameras[view.meta["view"]]
    stored = view.camera
    off = max(
        np.abs(stored.K - camera.K).max(), np.abs(stored.T_world_from_camera - camera.T).max()
    )
    off = max(off, float(np.abs(stored.distortion - np.array(camera.distortion)).max()))
    record.measure("camera", off, 1e-9, "stored K, T or distortion differs from the plan's")
    R = stored.T_world_from_camera[:3, :3]
    skew = max(np.abs(R @ R.T - np.eye(3)).max(), abs(np.linalg.det(R) - 1))
    record.measure("camera rotation", skew, 1e-9, "T_world_from_camera is not rigid")


def check_keypoints(record: Record, sample: Sample, view: View, rays: Rays) -> None:
    """Keypoints against the float64 reference, bones, chirality, limits, states."""
    K, T = view.camera.K, view.camera.T_world_from_camera
    for subject, hand in zip(sample.subjects, view.hands, strict=True):
        truth = _keypoints(subject)
        local = (truth - T[:3, 3]) @ T[:3, :3]
        pixels = _projected(local, K, view.camera.distortion)
        error = np.linalg.norm(hand.keypoints_2d - pixels, axis=1).max()
        record.measure(
            "keypoints_2d", error, REPROJECTION_PX, "px from the projected model keypoints"
        )
        error = np.linalg.norm(hand.keypoints_3d - local, axis=1).max()
        record.measure("keypoints_3d", error, KEYPOINT_3D_M, "m from the model keypoints")
        bone = float(np.linalg.norm(hand.keypoints_3d[9] - hand.keypoints_3d[0]))
        beyond = max(BONE_M[0] - bone, bone - BONE_M[1])
        record.measure("bone length", beyond, 0.0, f"wrist to middle MCP is {bone:.4f} m")
        record.measure("chirality", chirality(hand.keypoints_3d, hand.hand), 0.0,
                f"the palm is not that of a {hand.hand} hand")  # fmt: skip
        record.measure("side", float(hand.hand != subject.hand), 0.0, "side differs from the truth")
        limits = limits_of(subject.loaded)
        worst = violation(limits, subject.pose).max()
        record.measure("joint limits", worst, LIMIT_RAD, "rad beyond the joint limits")
        check_states(record, subject, hand, local, pixels, rays)


def _projected(local: Array, K: Array, distortion: Array) -> Array:
    """Project camera-frame points (n, 3) with OpenCV's own lens model."""
    still = np.zeros(3)
    pixels, _ = cv2.projectPoints(local[:, None], still, still, K, distortion)
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)


def _keypoints(subject: Subject) -> Array:
    vertices, joints = subject.loaded.evaluate_reference(
        subject.shape[None], subject.pose[None], subject.translation[None]
    )
    tips = vertices[0][subject.loaded.fingertip_ids]
    return np.concatenate([joints[0], tips])[list(OPENPOSE21_FROM_MANO21)]


def chirality(keypoints: NDArray[Any], hand: str) -> float:
    """Return > 0 where the thumb's side of the palm contradicts the labelled hand.

    Camera frame (x right, y down, z forward). Fingers bend towards the palm: the mean bend of the
    four fingers, with the direction from pinky to index, tells left from right.
    """
    p = np.asarray(keypoints, dtype=np.float64)
    fingers = p[9] - p[0]
    across = p[5] - p[17]  # pinky MCP to index MCP
    back = np.cross(fingers, across)  # out of the back of a right hand
    thumb = p[4] - p[2]
    bend = sum((p[4 * f + 8] - p[4 * f + 5]) / np.linalg.norm(p[4 * f + 8] - p[4 * f + 5])
               for f in range(4))  # fmt: skip
    towards_palm = -float((bend @ back) / np.linalg.norm(back))
    towards_palm += 0.5 * -float(thumb @ back / np.linalg.norm(back) / np.linalg.norm(thumb))
    side = towards_palm if hand == "right" else -towards_palm
    return -side - 1.0  # flat and slightly bent back fingers give no verdict


def check_states(
    record: Record, subject: Subject, hand: HandView, local: Array, pixels: Array, rays: Rays
) -> None:
    """Out of the frame exactly where the projection is; visible where the first surface is own."""
    margin = np.minimum(pixels + 0.5, rays.size - 0.5 - pixels).min(axis=1)
    state = hand.keypoints_state
    wrong = np.sum((state == 0) & (margin > 0.01)) + np.sum((state > 0) & (margin < -0.01))
    wrong += np.sum(state > 2)
    record.measure("keypoint frame", wrong, 0, "keypoints whose out-of-frame state is wrong")
    could, must = seen_keypoints(subject, hand.instance_id, pixels, local, rays)
    framed = (state > 0) & (margin > 0.01)
    wrong = np.sum((state == 2) & framed & ~could) + np.sum((state == 1) & framed & must)
    if vague := int(np.sum(framed & could & ~must)):
        record.skip("visible", "the keypoint lies at the very rim of what hides it", vague)
    if clear := int(np.sum(framed & (could == must))):
        record.measure("visible", wrong, 0, "keypoints said to be visible that are hidden, or the "
                       "reverse", clear)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Rays:
    """What rays of a view are cast at, through which camera; ``size`` is that of the picture."""

    layers: Sequence[Layer]
    camera: Camera

    @property
    def size(self) -> NDArray[np.int64]:
        """Width and height (2,), pixels."""
        return np.array([self.camera.width, self.camera.height])


def seen_keypoints(
    subject: Subject, number: int, pixels: Array, local: Array, rays: Rays
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which keypoints (21,) could be visible, and which must be.

    A keypoint is visible where the first surface on its ray is the skin of its own bone, or of the
    next ones, and no farther in front than flesh reaches. Five rays, through the keypoint's pixel
    (21, 2) and a twentieth of a pixel beside it: one of them is enough to be visible, all must be
    hidden to be hidden. ``local`` (21, 3) is in the camera's frame.
    """
    model = subject.loaded
    around = (pixels[:, None] + RIM_PX * _CROSS).reshape(-1, 2)
    hit = pierced(rays.layers, rays.camera, around)
    part = np.zeros(len(around), dtype=np.int64)
    on = hit.instance == number
    part[on] = DrawnSurface.for_model(model).part(hit.face[on], hit.barycentric[on])
    oblique = np.repeat(np.linalg.norm(local, axis=1) / local[:, 2], len(_CROSS))
    before = (np.repeat(local[:, 2], len(_CROSS)) - hit.depth_z_m) * oblique
    parts, hits, reach = (row.reshape(-1, len(_CROSS)) for row in (part, on, before))
    could, must = np.zeros(21, dtype=bool), np.zeros(21, dtype=bool)
    for k, joint in enumerate(OPENPOSE21_JOINT):
        bones = {joint, int(model.parents[joint]), *np.flatnonzero(model.parents == joint)}
        own = np.isin(parts[k], [b + 1 for b in bones if b >= 0])
        own |= (parts[k] == PART_FOREARM) & (joint == 0)
        own &= hits[k]
        flesh = TIP_M if k % 4 == 0 and k else FLESH * model.finger_radius[joint]
        could[k] = np.any(own & (reach[k] < flesh + RIM_M) & (reach[k] > -1e-3 - RIM_M))
        must[k] = np.all(own & (reach[k] < flesh - RIM_M) & (reach[k] > -1e-3 + RIM_M))
    return could, must


def check_masks(record: Record, sample: Sample, view: View, again: Redrawn) -> None:
    """Instances against the rasteriser, but for pixels hidden by the background or lamps."""
    mine, theirs = view.instance_id.astype(np.int64), again.instance
    silhouette = _edges(theirs)
    differ = mine != theirs
    if "depth" in view.columns:
        hidden = (mine == 0) & (theirs > 0) & (view.depth_z_m < again.depth_z_m - 5e-3)
        differ &= ~(hidden & (view.depth_z_m > 0))
    allowed = max(MASK_SHARE * silhouette.sum(), 2)
    record.measure("mask", differ.sum(), allowed, "pixels differ from the rasterised subjects")
    part = view.part_id
    record.measure(
        "part", np.sum((part > 0) != (mine > 0)), 0, "pixels with a part but no instance"
    )
    for found in objects_of(sample.spec.scene):
        own = mine == found.instance_id
        record.measure("object part", np.sum(own & (part != found.part_id)), 0,
                f"pixels of a {found.kind} with another part")  # fmt: skip


def _edges(mask: NDArray[np.int64]) -> NDArray[np.bool_]:
    edge = np.zeros(mask.shape, dtype=bool)
    edge[:, 1:] |= mask[:, 1:] != mask[:, :-1]
    edge[1:] |= mask[1:] != mask[:-1]
    return edge


def _inner(view: View, again: Redrawn) -> NDArray[np.bool_]:
    """Pixels on the same face of the same hand in both drawings."""
    same = (view.face_id == again.face) & (view.instance_id == again.instance)
    return np.asarray(same & (again.face >= 0))


def check_depth(record: Record, view: View, again: Redrawn) -> None:
    """Depth against the rasterised surface; a share of pixels, since rims may differ."""
    error = np.abs(view.depth_z_m - again.depth_z_m)[_inner(view, again)]
    if len(error):
        worst = float(np.quantile(error, 0.999))
        record.measure("depth", worst, DEPTH_M, "m from the rasterised surface (99.9 %)")
    else:
        record.skip("depth", UNDRAWN)
    sensor, hand = view.sensor_depth_z_m, view.instance_id > 0
    if sensor is not None and not (hand & (sensor > 0)).any():
        record.skip("sensor depth", "the sensor reports no pixel of a hand")
    elif sensor is not None:
        off = np.abs(sensor / np.where(view.valid, view.depth_z_m, 1) - 1)[hand & (sensor > 0)]
        record.measure("sensor depth", np.median(off), SENSOR_SHARE, "of the exact depth (median)")


def check_surface(record: Record, sample: Sample, view: View, again: Redrawn) -> None:
    """Faces, parts, texture coordinates and normals against the rasterised surface."""
    inner = _inner(view, again)
    drawn_pixels = int((again.face >= 0).sum())
    if drawn_pixels:
        record.measure("face", 1 - inner.sum() / drawn_pixels, 0.06,
                       "share of hand pixels on another face than rasterised")  # fmt: skip
    else:
        record.skip("face", UNDRAWN)
    for number, subject in enumerate(sample.subjects, start=1):
        own = inner & (again.instance == number)
        if not own.any():
            record.skip("uv", UNDRAWN)
            record.skip("barycentrics", UNDRAWN)
            record.skip("parts", UNDRAWN)
            continue
        drawn = DrawnSurface.for_model(subject.loaded)
        uv = drawn.texture(again.face[own], again.barycentric[own])
        record.measure(
            "uv", np.quantile(np.abs(view.uv[own] - uv), 0.999), UV, "from the face's atlas"
        )
        inside = np.abs(view.barycentric[own] - again.barycentric[own])
        record.measure("barycentrics", np.quantile(inside, 0.99), BARYCENTRIC,
                       "from the rasterised point of the face (99 %)")  # fmt: skip
        part = drawn.part(again.face[own], again.barycentric[own])
        wrong = np.mean(part != view.part_id[own])
        record.measure("parts", wrong, 0.005, "share of pixels with another part than their face")
    stored = "depth" in view.columns
    normals = view.normals[view.valid if stored else view.instance_id > 0]
    if len(normals):
        length = np.abs(np.linalg.norm(normals, axis=1) - 1).max()
        record.measure("normal length", length, 1e-3, "normals are not unit vectors")
    else:
        record.skip("normal length", "no pixel shows any surface")
    bend = _normal_error(view, view.depth_z_m if stored else again.depth_z_m, inner)
    if bend is None:
        record.skip("normals", f"fewer than {FEWEST_SMOOTH} pixels lie on smooth surface")
    else:
        record.measure("normals", bend, 12.0, "degrees (median) from normals of the depth map")


def _normal_error(view: View, depth_z_m: NDArray[Any], inner: NDArray[np.bool_]) -> float | None:
    """Median angle between stored normals and those of neighbouring depths, degrees.

    None where fewer than 50 pixels have neighbours on the same smooth surface.
    """
    K, z = view.camera.K, depth_z_m.astype(np.float64)
    v, u = np.mgrid[: z.shape[0], : z.shape[1]]
    p = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=-1)
    dx, dy = p[2:-2, 4:] - p[2:-2, :-4], p[4:, 2:-2] - p[:-4, 2:-2]
    smooth = (np.abs(dx[..., 2]) < 4e-3) & (np.abs(dy[..., 2]) < 4e-3) & inner[2:-2, 2:-2]
    # Across a thin tip both neighbours may be background.
    smooth &= (z[2:-2, 4:] > 0) & (z[4:, 2:-2] > 0)
    if smooth.sum() < FEWEST_SMOOTH:
        return None
    n = np.cross(dy, dx)[smooth]
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    cosine = np.sum(n * view.normals[2:-2, 2:-2][smooth], axis=1)
    return float(np.rad2deg(np.median(np.arccos(np.clip(cosine, -1, 1)))))
