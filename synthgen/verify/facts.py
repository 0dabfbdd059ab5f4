"""Checks of what stands beside the pictures: boxes, counts, ids, names, units, and the EXR.

Read off the stored label images again, which other checks compare with the rasteriser: a loader
that takes its crops, its joint order or its metres from the meta must not be misled by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from synthgen.corpus.columns import DEPTH_STEP_M, decode_exr, exr_header
from synthgen.corpus.sample import Sample, View
from synthgen.models.joints import OPENPOSE21_NAMES, PART_FOREARM
from synthgen.scene.instances import objects_of
from synthgen.verify.report import Record

Mask = NDArray[np.bool_]

FARTHEST_STEPS = 65535  # what the depth column can say
EXR_DEPTH_M, EXR_K_PX = DEPTH_STEP_M / 2 + 1e-6, 1e-3
# Rank correlation of the picture's brightness with the linear one; of 12 pictures of hand_full, the
# darkest and noisiest included, at least 0.95, of another sample's at most 0.7.
ALIKE = 0.85
# Rank correlation of hues that swapped channels fall below; of grey scenes it is about 0.
SWAPPED = -0.1


def check_facts(record: Record, sample: Sample, view: View) -> None:
    """Compare a view's meta with its label images, the scene, and what readers rely on."""
    wrong = _misnamed(sample, view)
    record.measure("meta", len(wrong), 0, f"not what readers rely on: {', '.join(wrong)}")
    record.measure("objects", _strangers(sample, view), 0,
                   "rows of objects that are missing, too many, or of another kind")  # fmt: skip
    if "labels" not in view.columns:
        return
    ids, part = view.instance_id, view.part_id
    rows = [
        (row, (ids == k) & (part < PART_FOREARM)) for k, row in enumerate(view.meta["hands"], 1)
    ]
    rows += [(row, ids == row["instance_id"]) for row in view.objects]
    for row, seen in rows:
        what = row.get("hand", row.get("kind"))
        record.measure("box", _box_off(row["box_xyxy"], seen), 0,
                       f"px between the stored box and what is seen of a {what}")  # fmt: skip
        record.measure("pixels", abs(row["pixels"] - int(seen.sum())), 0,
                       f"pixels by which the stored count of a {what} is off")  # fmt: skip


def _misnamed(sample: Sample, view: View) -> list[str]:
    """Name the entries of the meta by which readers take labels, and that are not as promised."""
    meta, camera = view.meta, sample.spec.scene.cameras[view.meta["view"]]
    wrong = [] if meta["keypoint_names"] == list(OPENPOSE21_NAMES) else ["keypoint_names"]
    wrong += [] if meta["depth_step_m"] == DEPTH_STEP_M else ["depth_step_m"]
    wrong += [] if (meta["width"], meta["height"]) == (camera.width, camera.height) else ["width"]
    for k, (hand, subject) in enumerate(zip(meta["hands"], sample.subjects, strict=True), start=1):
        wrong += [] if hand["instance_id"] == k else ["instance_id"]
        known = hand["fingertip_set"] == subject.loaded.fingertip_set
        wrong += [] if known else ["fingertip_set"]
    return wrong


def _strangers(sample: Sample, view: View) -> int:
    names = ("instance_id", "part_id", "kind", "subject")
    told = {tuple(row[name] for name in names) for row in view.objects}
    known = {tuple(getattr(row, name) for name in names) for row in objects_of(sample.spec.scene)}
    return len(told ^ known) + len(view.objects) - len(told)


def _box_off(box: Sequence[int] | None, seen: Mask) -> float:
    """Largest difference of a stored box from that of a mask, pixels; one of both missing: all."""
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if box is None or len(rows) == 0:
        return 0.0 if box is None and len(rows) == 0 else float(max(seen.shape))
    true = [columns[0], rows[0], columns[-1], rows[-1]]
    return float(np.abs(np.subtract(box, true)).max())


def check_exr(record: Record, view: View) -> None:
    """Compare the exr column with the others: depth, ids, intrinsics, and the picture."""
    data = view.stored("exr", "exr")
    exr = decode_exr(data)
    off = np.abs(np.asarray(exr_header(data)["K"]).reshape(3, 3) - view.camera.K).max()
    record.measure("exr K", off, EXR_K_PX, "the header's intrinsics are not the view's")
    if "labels" in view.columns:
        wrong = np.sum(exr["instance"] != view.instance_id) + np.sum(exr["part"] != view.part_id)
        record.measure("exr ids", wrong, 0, "pixels with other ids than in the labels")
    if "depth" in view.columns:
        steps = np.rint(exr["Z"].astype(np.float64) / DEPTH_STEP_M)
        z = np.where(steps > FARTHEST_STEPS, 0, exr["Z"])
        record.measure("exr depth", np.abs(z - view.depth_z_m).max(), EXR_DEPTH_M,
                       "m between Z and the depth column")  # fmt: skip
    if "image" in view.columns:
        _check_linear(record, exr["RGB"].astype(np.float64), view.image.astype(np.float64))


def _check_linear(record: Record, linear: NDArray[Any], image: NDArray[Any]) -> None:
    """Check that the picture is this radiance through a camera: as bright, and of its hue."""
    alike = _rank_correlation(linear.sum(axis=2), image.sum(axis=2))
    if alike is None:
        record.skip("exr picture", "the picture has no contrast")
        return
    record.measure("exr picture", -alike, -ALIKE,
                   f"brightness of RGB and of the picture correlate to {alike:.2f}")  # fmt: skip
    hue = _rank_correlation(_redness(linear, 1e-4), _redness(image, 1.0))
    if hue is None:
        record.skip("exr channels", "the picture has no hue")
    else:
        record.measure("exr channels", -hue, -SWAPPED,
                       "red where the picture is blue; channels swapped?")  # fmt: skip


def _redness(image: NDArray[Any], dark: float) -> NDArray[Any]:
    return np.asarray(np.log((image[..., 0] + dark) / (image[..., 2] + dark)))


def _rank_correlation(one: NDArray[Any], other: NDArray[Any]) -> float | None:
    if np.ptp(one) == 0 or np.ptp(other) == 0:
        return None
    return float(stats.spearmanr(one.ravel(), other.ravel()).statistic)
