"""The checks: each recomputes labels of one view from the stored truth, by other means.

Other means: the model's float64 reference instead of its fast kernels, a z-buffer rasteriser
instead of Mitsuba, plain matrix products instead of the camera code that the renderer used.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from synthgen.corpus.columns import DEPTH_STEP_M
from synthgen.corpus.sample import Sample, Subject, View
from synthgen.models.joints import OPENPOSE21_FROM_MANO21, OPENPOSE21_JOINT, PART_FOREARM
from synthgen.sampling.limits import limits_of, violation
from synthgen.scene.instances import objects_of
from synthgen.scene.surface import DrawnSurface
from synthgen.verify.redraw import Redrawn, redraw
from synthgen.verify.report import VerifyReport

Array = NDArray[np.float64]

REPROJECTION_PX, KEYPOINT_3D_M = 0.05, 2e-5
MASK_SHARE = 0.001  # of silhouette pixels
DEPTH_M = DEPTH_STEP_M / 2 + 2e-5
NORMAL_DEG, UV, LIMIT_RAD = 1.0, 2e-3, 1e-4
BONE_M = (0.05, 0.13)
FLESH = 2.2  # thickest flesh on the way to a joint, over the typical radius there
# Red over blue of the bluest skylight; and the contrast that edges must have over chance.
SKY_HUE = 0.6


def check_view(report: VerifyReport, sample: Sample, view: View) -> None:
    """Run every check of one view."""
    again = redraw(sample, view)
    number = view.meta["view"]

    def measure(check: str, value: Any, limit: float, message: str) -> None:
        report.measure(sample.index, number, check, float(value), limit, message)

    check_camera(measure, sample, view)
    check_keypoints(measure, sample, view, again)
    check_masks(measure, sample, view, again)
    check_depth(measure, view, again)
    check_surface(measure, sample, view, again)
    check_image(measure, sample, view)


def check_camera(measure: Any, sample: Sample, view: View) -> None:
    """Check that the stored calibration equals the spec's and its rotation is one."""
    camera = sample.spec.scene.cameras[view.meta["view"]]
    stored = view.camera
    off = max(
        np.abs(stored.K - camera.K).max(), np.abs(stored.T_world_from_camera - camera.T).max()
    )
    off = max(off, float(np.abs(stored.distortion - np.array(camera.distortion)).max()))
    measure("camera", off, 1e-9, "stored K, T or distortion differs from the plan's")
    R = stored.T_world_from_camera[:3, :3]
    skew = max(np.abs(R @ R.T - np.eye(3)).max(), abs(np.linalg.det(R) - 1))
    measure("camera rotation", skew, 1e-9, "T_world_from_camera is not rigid")


def check_keypoints(measure: Any, sample: Sample, view: View, again: Redrawn) -> None:
    """Keypoints against the float64 reference, bones, chirality, limits, states."""
    K, T = view.camera.K, view.camera.T_world_from_camera
    for subject, hand in zip(sample.subjects, view.hands, strict=True):
        truth = _keypoints(subject)
        local = (truth - T[:3, 3]) @ T[:3, :3]
        pixels = _projected(local, K, view.camera.distortion)
        error = np.linalg.norm(hand.keypoints_2d - pixels, axis=1).max()
        measure("keypoints_2d", error, REPROJECTION_PX, "px from the projected model keypoints")
        error = np.linalg.norm(hand.keypoints_3d - local, axis=1).max()
        measure("keypoints_3d", error, KEYPOINT_3D_M, "m from the model keypoints")
        bone = float(np.linalg.norm(hand.keypoints_3d[9] - hand.keypoints_3d[0]))
        beyond = max(BONE_M[0] - bone, bone - BONE_M[1])
        measure("bone length", beyond, 0.0, f"wrist to middle MCP is {bone:.4f} m")
        measure("chirality", chirality(hand.keypoints_3d, hand.hand), 0.0,
                f"the palm is not that of a {hand.hand} hand")  # fmt: skip
        measure("side", float(hand.hand != subject.hand), 0.0, "side differs from the truth")
        limits = limits_of(subject.loaded)
        worst = violation(limits, subject.pose).max()
        measure("joint limits", worst, LIMIT_RAD, "rad beyond the joint limits")
        check_states(measure, subject, hand, pixels, local[:, 2], view, again)


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
    measure: Any, subject: Subject, hand: Any, pixels: Array, z: Array, view: View, again: Redrawn
) -> None:
    """Out of the frame exactly where the projection is; visible only near the seen surface."""
    size = np.array([view.meta["width"], view.meta["height"]])
    margin = np.minimum(pixels + 0.5, size - 0.5 - pixels).min(axis=1)
    state = hand.keypoints_state
    wrong = np.sum((state == 0) & (margin > 0.01)) + np.sum((state > 0) & (margin < -0.01))
    measure("keypoint frame", wrong, 0, "keypoints whose out-of-frame state is wrong")
    column, row = np.clip(np.rint(pixels).astype(int), 0, size - 1).T
    # The farthest of the pixels around: a keypoint's ray passes between their centres.
    surface = ndimage.maximum_filter(again.depth_z_m, 3)[row, column]
    on_hand = again.face[row, column] >= 0
    flesh = FLESH * subject.loaded.finger_radius[list(OPENPOSE21_JOINT)] + 0.01
    deep = (state == 2) & on_hand & (z - surface > flesh)
    measure("visible too deep", deep.sum(), 0, "visible keypoints farther in than flesh reaches")
    hidden = ndimage.minimum_filter(again.covered, 5)[row, column]
    measure("occlusion", np.sum((state == 2) & hidden), 0, "visible keypoints behind an object")


def check_masks(measure: Any, sample: Sample, view: View, again: Redrawn) -> None:
    """Instances against the rasteriser, but for pixels hidden by the background or lamps."""
    mine, theirs = view.instance_id.astype(np.int64), again.instance
    silhouette = _edges(theirs)
    differ = mine != theirs
    hidden = (mine == 0) & (theirs > 0) & (view.depth_z_m < again.depth_z_m - 5e-3)
    differ &= ~(hidden & (view.depth_z_m > 0))
    allowed = max(MASK_SHARE * silhouette.sum(), 2)
    measure("mask", differ.sum(), allowed, "pixels differ from the rasterised subjects")
    part = view.part_id
    measure("part", np.sum((part > 0) != (mine > 0)), 0, "pixels with a part but no instance")
    for found in objects_of(sample.spec.scene):
        own = mine == found.instance_id
        measure("object part", np.sum(own & (part != found.part_id)), 0,
                f"pixels of a {found.kind} with another part")  # fmt: skip
        stored = next(o for o in view.objects if o["instance_id"] == found.instance_id)
        measure("object pixels", abs(stored["pixels"] - int(own.sum())), 0,
                f"the stored pixel count of a {found.kind} differs")  # fmt: skip


def _edges(mask: NDArray[np.int64]) -> NDArray[np.bool_]:
    edge = np.zeros(mask.shape, dtype=bool)
    edge[:, 1:] |= mask[:, 1:] != mask[:, :-1]
    edge[1:] |= mask[1:] != mask[:-1]
    return edge


def _inner(view: View, again: Redrawn) -> NDArray[np.bool_]:
    """Pixels on the same face of the same hand in both drawings."""
    same = (view.face_id == again.face) & (view.instance_id == again.instance)
    return np.asarray(same & (again.face >= 0))


def check_depth(measure: Any, view: View, again: Redrawn) -> None:
    """Depth against the rasterised surface; shares of pixels, since rims may differ."""
    inner = _inner(view, again)
    error = np.abs(view.depth_z_m - again.depth_z_m)[inner]
    worst = float(np.quantile(error, 0.999)) if len(error) else np.inf
    measure("depth", worst, DEPTH_M, "m from the rasterised surface (99.9 %)")
    same = inner.sum() / max((again.face >= 0).sum(), 1)
    measure("face", 1 - same, 0.06, "share of hand pixels on another face than rasterised")


def check_surface(measure: Any, sample: Sample, view: View, again: Redrawn) -> None:
    """Parts, texture coordinates and normals against faces and depth."""
    inner = _inner(view, again)
    for number, subject in enumerate(sample.subjects, start=1):
        own = inner & (again.instance == number)
        if not own.any():
            continue
        drawn = DrawnSurface.for_model(subject.loaded)
        uv = drawn.texture(again.face[own], again.barycentric[own])
        measure("uv", np.quantile(np.abs(view.uv[own] - uv), 0.999), UV, "from the face's atlas")
        part = drawn.part(again.face[own], again.barycentric[own])
        wrong = np.mean(part != view.part_id[own])
        measure("parts", wrong, 0.005, "share of pixels with another part than their face")
    normals = view.normals[view.valid]
    length = np.abs(np.linalg.norm(normals, axis=1) - 1).max() if len(normals) else np.inf
    measure("normal length", length, 1e-3, "normals are not unit vectors")
    bend = _normal_error(view, inner)
    measure("normals", bend, 12.0, "degrees (median) from normals of the depth map")


def _normal_error(view: View, inner: NDArray[np.bool_]) -> float:
    """Median angle between stored normals and those of neighbouring depths, degrees."""
    K, z = view.camera.K, view.depth_z_m.astype(np.float64)
    v, u = np.mgrid[: z.shape[0], : z.shape[1]]
    p = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=-1)
    dx, dy = p[2:-2, 4:] - p[2:-2, :-4], p[4:, 2:-2] - p[:-4, 2:-2]
    smooth = (np.abs(dx[..., 2]) < 4e-3) & (np.abs(dy[..., 2]) < 4e-3) & inner[2:-2, 2:-2]
    if smooth.sum() < 50:
        return 0.0
    n = np.cross(dy, dx)[smooth]
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    cosine = np.sum(n * view.normals[2:-2, 2:-2][smooth], axis=1)
    return float(np.rad2deg(np.median(np.arccos(np.clip(cosine, -1, 1)))))


def check_image(measure: Any, sample: Sample, view: View) -> None:
    """Check that the picture shows this scene: skin is red over blue, edges where labels have."""
    skin = (view.part_id > 0) & (view.part_id <= PART_FOREARM)
    if skin.sum() < 50:
        return
    mean = view.image[skin].astype(np.float64).mean(axis=0)
    if _redness(sample) > 1.1:
        measure("skin hue", mean[2] - mean[0], 0.0, "skin is bluer than red; channels swapped?")
    measure("stale image", -_edge_rank(view), -0.56, "no edge where the labels have theirs")
    mirrored = _mirrored_gain(view)
    measure("mirrored image", mirrored, 1.0, "edges follow the mirrored labels, not the labels")


def _redness(sample: Sample) -> float:
    """Least red over blue of the skins as the picture may show them, by the truth.

    A camera that balances white leaves a quarter of the light's hue (in its logarithm), and its
    own error.
    """
    scene = sample.spec.scene
    colours = [scene.lights.constant_rgb, *(lamp.radiance_rgb for lamp in scene.lights.area)]
    hues = [c[0] / max(c[2], 1e-9) for c in colours if sum(c) > 0]
    hues += [SKY_HUE] if scene.lights.sky is not None else []
    balanced = scene.sensor.white_balance
    light = min(hues) ** (0.25 if balanced else 1.0)
    error = scene.sensor.balance_error
    skins = [s.skin.dorsal_rgb[0] / s.skin.dorsal_rgb[2] for s in scene.subjects]
    return float(min(skins) * light * error[0] / error[2])


def _edge_rank(view: View) -> float:
    """Share of the labels' edge pixels where the picture changes more than it does around them.

    Around: 24 places 8 to 24 px away; 0.5 by chance, whatever the contrast.
    """
    grey = _grey(view)
    change = np.zeros_like(grey)
    change[2:-3, 2:-3] = np.abs(grey[4:-1, 2:-3] - grey[:-5, 2:-3])
    change[2:-3, 2:-3] += np.abs(grey[2:-3, 4:-1] - grey[2:-3, :-5])
    outline = np.argwhere(_label_edges(view))
    size = np.array(grey.shape)
    outline = outline[np.all((outline >= 30) & (outline < size - 30), axis=1)]
    if len(outline) < 100:
        return 1.0  # too little to tell
    turns = np.arange(8) * np.pi / 4
    around = [
        change[tuple((outline + np.rint([r * np.sin(a), r * np.cos(a)]).astype(int)).T)]
        for r in (8, 16, 24)
        for a in turns
    ]
    return float(np.mean(change[tuple(outline.T)] > np.median(around, axis=0)))


def _mirrored_gain(view: View) -> float:
    """Image contrast across the labels' edges mirrored over that across the edges."""
    grey = _grey(view)
    outline = np.argwhere(_label_edges(view))
    flipped = np.stack([outline[:, 0], grey.shape[1] - outline[:, 1]], axis=1)
    return _contrast(grey, flipped) / max(_contrast(grey, outline), 1e-6)


def _grey(view: View) -> Array:
    """Lightness (H, W), blurred by a pixel: noise of few light paths would drown the edges."""
    grey = view.image.astype(np.float64) @ [0.299, 0.587, 0.114]
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.0), dtype=np.float64)


def _label_edges(view: View) -> NDArray[np.bool_]:
    """Pixels where instances meet or depth jumps."""
    return np.asarray(_edges(view.instance_id.astype(np.int64)) | _jumps(view))


def _jumps(view: View) -> NDArray[np.bool_]:
    """Where depth jumps by over 5 % between neighbours."""
    z = np.log(np.maximum(view.depth_z_m, 1e-3))
    jump = np.zeros(z.shape, dtype=bool)
    jump[:, 1:] |= np.abs(z[:, 1:] - z[:, :-1]) > 0.05
    jump[1:] |= np.abs(z[1:] - z[:-1]) > 0.05
    return jump


def _contrast(grey: Array, where: NDArray[np.int64]) -> float:
    size = np.array(grey.shape)
    inside = where[np.all((where >= 3) & (where < size - 3), axis=1)]
    if len(inside) == 0:
        return 0.0
    r, c = inside.T
    step = np.abs(grey[r + 2, c] - grey[r - 3, c]) + np.abs(grey[r, c + 2] - grey[r, c - 3])
    return float(step.mean())
