"""Encoding one view of a sample into the members of the corpus's columns, and back.

==========  ==================  ============================================================
column      member              content
==========  ==================  ============================================================
image       KEY.jpg             sRGB JPEG
depth       KEY.depth.png       16-bit, z along the optical axis, 0.1 mm, 0 = nothing or too far
..          KEY.sensor.png      the same as a depth camera reports it, where asked for
labels      KEY.part.png        8-bit part ids
..          KEY.instance.png    8-bit instance ids, 0 background
..          KEY.normals.png     16-bit x 3, camera frame, round((n + 1) / 2 * 65534)
..          KEY.face.png        16-bit x 3: face id + 1, first two barycentrics * 65535
..          KEY.uv.png          16-bit x 3: u, v * 65535, third channel 0
meta        KEY.json            everything that the sample was made from, cameras, keypoints
exr         KEY.exr             OpenEXR: half R G B linear, float Z, uint part and instance, K
scan        KEY.scan.ply ...    see :mod:`synthgen.corpus.scans`; view 0 only
stereo      KEY.UNIT.left.png   see :mod:`synthgen.corpus.scans`; view 0 only
==========  ==================  ============================================================
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.errors import CorpusError, IntegrityError
from synthgen.models import load_hand
from synthgen.models.joints import OPENPOSE21_NAMES
from synthgen.render.renderer import RenderedView
from synthgen.sampling.spec import SampleSpec
from synthgen.scene.instances import objects_of

DEPTH_STEP_M = 1e-4
SCHEMA = 1
Members = dict[str, bytes]


def key_of(index: int, view: int) -> str:
    """Return the key of one view of one sample; the same in every column."""
    return f"{index:09d}_{view:02d}"


@dataclass(frozen=True, eq=False)
class ScannedView(RenderedView):
    """A view that brings encoded members of columns, and facts for its meta, with it."""

    members: dict[str, Members] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)


def encode_view(
    spec: SampleSpec, number: int, view: RenderedView, columns: tuple[str, ...], quality: int
) -> dict[str, Members]:
    """Encode one view into ``{column: {suffix: bytes}}``; the same input gives the same bytes.

    A scene's sensor may have a JPEG quality of its own.
    """
    if view.image is None or view.linear is None:
        raise CorpusError(f"sample {spec.index} view {number} has labels but no picture")
    quality = spec.scene.sensor.jpeg_quality or quality
    bgr = np.ascontiguousarray(view.image[..., ::-1])
    facts = view.facts if isinstance(view, ScannedView) else {}
    encoded: dict[str, Members] = {
        "image": {"jpg": _encode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])},
        "depth": {"depth.png": png(depth_steps(view.labels.depth_z_m))},
        "labels": _label_members(view),
        "meta": {"json": _json(describe(spec, number, view) | facts)},
    }
    if "exr" in columns:
        encoded["exr"] = {"exr": _exr(view)}
    if isinstance(view, ScannedView):
        for name, members in view.members.items():
            encoded[name] = encoded.get(name, {}) | members
    return {name: encoded.get(name, {}) for name in columns}


def _label_members(view: RenderedView) -> Members:
    labels = view.labels
    face = np.zeros((*labels.face_id.shape, 3), dtype=np.uint16)
    if labels.face_id.max(initial=-1) >= 65535:
        raise CorpusError("a model with 65535 faces or more does not fit the face column")
    on = labels.face_id >= 0
    face[..., 0] = labels.face_id + 1
    face[on, 1:] = np.rint(labels.barycentric[on, :2].astype(np.float64) * 65535)
    uv = np.zeros_like(face)
    uv[..., :2] = np.rint(np.clip(labels.uv, 0, 1).astype(np.float64) * 65535)
    normals = np.rint((labels.normals.astype(np.float64) + 1) / 2 * 65534).astype(np.uint16)
    return {
        "part.png": png(labels.part_id),
        "instance.png": png(labels.instance_id),
        "normals.png": png(normals),
        "face.png": png(face),
        "uv.png": png(uv),
    }


def describe(spec: SampleSpec, number: int, view: RenderedView) -> dict[str, Any]:
    """Return the meta of one view: the whole spec, this camera, its hands and objects."""
    camera = view.camera
    hands = []
    for k, (subject, hand) in enumerate(zip(spec.scene.subjects, view.hands, strict=True)):
        model = load_hand(subject.model, hand=subject.hand)
        own = (view.labels.instance_id == k + 1) & (view.labels.part_id <= 16)
        hands.append(
            {
                "instance_id": k + 1,
                "hand": subject.hand,
                "model_digest": model.digest,
                "fingertip_set": model.fingertip_set,
                "keypoints_2d": hand.keypoints_2d.tolist(),
                "keypoints_3d_m": hand.keypoints_3d.tolist(),
                "keypoints_state": hand.keypoints_state.tolist(),
                "box_xyxy": _box(own),
                "pixels": int(own.sum()),
            }
        )
    objects = []
    for found in objects_of(spec.scene):
        seen = view.labels.instance_id == found.instance_id
        objects.append(
            {
                "instance_id": found.instance_id,
                "part_id": found.part_id,
                "kind": found.kind,
                "subject": found.subject,
                "box_xyxy": _box(seen),
                "pixels": int(seen.sum()),
            }
        )
    return {
        "schema": SCHEMA,
        "key": key_of(spec.index, number),
        "view": number,
        "width": camera.width,
        "height": camera.height,
        "K": camera.K.tolist(),
        "T_world_from_camera": camera.T.tolist(),
        "distortion": list(camera.distortion),
        "depth_step_m": DEPTH_STEP_M,
        "exposure": view.exposure,
        "keypoint_names": list(OPENPOSE21_NAMES),
        "hands": hands,
        "objects": objects,
        "spec": spec.to_json(),
    }


def _box(mask: NDArray[np.bool_]) -> list[int] | None:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    return [int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])]


def depth_steps(depth_z_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return depths (H, W), metres, in stored steps; 0 where they do not fit."""
    steps = np.rint(depth_z_m.astype(np.float64) / DEPTH_STEP_M)
    return np.where(steps > 65535, 0, steps).astype(np.uint16)


def png(image: NDArray[Any]) -> bytes:
    """Encode 8- or 16-bit images, one or three channels (stored in the array's order)."""
    ordered = np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image
    return _encode(".png", ordered, [cv2.IMWRITE_PNG_COMPRESSION, 3])


def _encode(kind: str, image: NDArray[Any], options: list[int]) -> bytes:
    done, data = cv2.imencode(kind, image, options)
    if not done:
        raise CorpusError(f"cannot encode an image of shape {image.shape} as {kind}")
    return data.tobytes()


def _json(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _exr(view: RenderedView) -> bytes:
    import OpenEXR

    assert view.linear is not None
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "K": view.camera.K.astype(np.float32),
        "exposure": float(view.exposure),
    }
    channels = {
        "RGB": np.clip(view.linear, 0, 65504).astype(np.float16),
        "Z": view.labels.depth_z_m,
        "part": view.labels.part_id.astype(np.uint32),
        "instance": view.labels.instance_id.astype(np.uint32),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "view.exr"
        OpenEXR.File(header, channels).write(str(path))
        return path.read_bytes()


def decode_image(data: bytes, what: str, channels: int = 0) -> NDArray[Any]:
    """Decode a JPEG or PNG; three-channel images come back in the order they were stored.

    Raises
    ------
    IntegrityError
        Naming ``what``, if the bytes are no image or have other channels than asked for.
    """
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or (image.ndim == 3) != (channels == 3):
        raise IntegrityError(f"{what} is damaged: its bytes are not the image expected")
    return image[..., ::-1] if channels == 3 else image


def decode_exr(data: bytes) -> dict[str, NDArray[Any]]:
    """Decode the exr column: arrays by channel name (``RGB``, ``Z``, ``part``, ``instance``)."""
    with _opened(data) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def exr_header(data: bytes) -> dict[str, Any]:
    """Decode the attributes of an exr's header: ``K`` (3, 3) pixels and ``exposure`` are ours."""
    with _opened(data) as file:
        return dict(file.header())


@contextmanager
def _opened(data: bytes) -> Iterator[Any]:
    import OpenEXR

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "view.exr"
        path.write_bytes(data)
        with OpenEXR.File(str(path)) as file:
            yield file
