"""Reading one sample: lazily decoded views, subjects recomputed from the stored truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.columns import DEPTH_STEP_M, decode_exr, decode_image
from synthgen.errors import CorpusError
from synthgen.geometry.cameras import camera_from_K, pixel_rays
from synthgen.models import ManoModel, load_hand
from synthgen.sampling.spec import SampleSpec
from synthgen.scene import HandSubject

if TYPE_CHECKING:
    from synthgen.scanner import Scan

Fetch = Callable[[str, str], bytes]


@dataclass(frozen=True, eq=False)
class ViewCamera:
    """Calibration of a view: ``K`` (3, 3) px, ``T_world_from_camera`` (4, 4), distortion (5,)."""

    K: NDArray[np.float64]
    T_world_from_camera: NDArray[np.float64]
    distortion: NDArray[np.float64]
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class HandView:
    """Labels of one hand in one view; OpenPose-21 order.

    ``keypoints_2d`` (21, 2) px, ``keypoints_3d`` (21, 3) metres in the camera's frame,
    ``keypoints_state`` (21,): 0 out of the frame, 1 occluded, 2 visible; ``box_xyxy`` of the
    visible hand, pixels inclusive, or None.
    """

    hand: str
    instance_id: int
    keypoints_2d: NDArray[np.float32]
    keypoints_3d: NDArray[np.float32]
    keypoints_state: NDArray[np.uint8]
    box_xyxy: tuple[int, int, int, int] | None


class Subject:
    """The truth of one hand, world frame, metres; vertices are recomputed from parameters.

    ``digest`` is that of the model the sample was made with; another one is refused.
    """

    def __init__(self, subject: HandSubject, digest: str) -> None:
        self._subject = subject
        self._digest = digest
        self.model = subject.model
        self.hand = subject.hand
        self.shape = np.array(subject.shape)
        self.pose = np.array(subject.pose)
        self.translation = np.array(subject.translation_m)

    def __repr__(self) -> str:
        return f"<Subject: {self.hand} hand of {self.model}>"

    @property
    def description(self) -> HandSubject:
        """The subject as the plan describes it (skin, arm, identity)."""
        return self._subject

    @cached_property
    def loaded(self) -> ManoModel:
        """The model, on the right side.

        Raises
        ------
        CorpusError
            If the model found under this name is not the one the sample was made with.
        """
        model = load_hand(self.model, hand=self._subject.hand)
        if model.digest != self._digest:
            raise CorpusError(
                f"the model {self.model!r} found here has digest {model.digest[:12]}, the sample "
                f"was made with {self._digest[:12]}: its vertices would be wrong. Restore that "
                "model's file"
            )
        return model

    @cached_property
    def _posed(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        posed = self.loaded.evaluate(self.shape[None], self.pose[None], self.translation[None])
        return posed.vertices[0], posed.joints[0]

    @property
    def vertices(self) -> NDArray[np.float32]:
        """Posed vertices (V, 3) of the hand."""
        return self._posed[0]

    @property
    def joints(self) -> NDArray[np.float32]:
        """Posed joints (K, 3)."""
        return self._posed[1]


class View:
    """One camera's picture and labels; every array is decoded when it is asked for.

    ``columns`` names what the corpus stores; an array of another column is refused.
    """

    def __init__(self, meta: dict[str, Any], fetch: Fetch, columns: frozenset[str]) -> None:
        self.meta = meta
        self._fetch = fetch
        self.key: str = meta["key"]
        self.columns = columns

    def __repr__(self) -> str:
        hands = ", ".join(f"{row['hand']} hand" for row in self.meta["hands"])
        return f"<View {self.key}: {hands}; columns {', '.join(sorted(self.columns))}>"

    @property
    def stored_member(self) -> Fetch:
        """Reads a stored member by column and full name."""
        return self._fetch

    def stored(self, column: str, suffix: str) -> bytes:
        """Return the stored bytes of one member, for example ``("image", "jpg")``."""
        return self._fetch(column, f"{self.key}.{suffix}")

    def _image(self, column: str, suffix: str, channels: int) -> NDArray[Any]:
        if column not in self.columns:
            raise CorpusError(f"{self.key}: this corpus stores no column {column}")
        data = self._fetch(column, f"{self.key}.{suffix}")
        image = decode_image(data, f"{self.key}.{suffix}", channels)
        size = (self.meta["height"], self.meta["width"])
        if image.shape[:2] != size:
            raise CorpusError(f"{self.key}.{suffix} is {image.shape[:2]}; its camera is {size}")
        return image

    @cached_property
    def image(self) -> NDArray[np.uint8]:
        """Picture (H, W, 3) uint8, sRGB, as stored."""
        return np.ascontiguousarray(self._image("image", "jpg", 3))

    @cached_property
    def linear(self) -> NDArray[np.float32] | None:
        """Linear radiance (H, W, 3) where the corpus has an exr column, else None."""
        try:
            data = self._fetch("exr", f"{self.key}.exr")
        except KeyError:
            return None
        return decode_exr(data)["RGB"].astype(np.float32)

    @cached_property
    def depth_z_m(self) -> NDArray[np.float32]:
        """Depth (H, W) along the optical axis, metres, background included; 0 = nothing hit."""
        steps = self._image("depth", "depth.png", 0)
        return np.asarray(steps * DEPTH_STEP_M, dtype=np.float32)

    @cached_property
    def distance_m(self) -> NDArray[np.float32]:
        """Distance (H, W) from the camera's centre, metres, from the stored depth."""
        c = self.camera
        camera = camera_from_K(c.K, c.width, c.height, distortion=c.distortion)
        along = pixel_rays(camera)[1][..., 2]
        return np.asarray(self.depth_z_m / along, dtype=np.float32)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where depth is known (H, W)."""
        return self.depth_z_m > 0

    @cached_property
    def sensor_depth_z_m(self) -> NDArray[np.float32] | None:
        """What a depth camera would report (H, W), metres, 0 = nothing; None: none is simulated."""
        if "sensor_depth" not in self.meta:
            return None
        steps = self._image("depth", "sensor.png", 0)
        return np.asarray(steps * DEPTH_STEP_M, dtype=np.float32)

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        """Normals (H, W, 3), camera frame, unit, towards the camera; stored to 3e-5."""
        stored = self._image("labels", "normals.png", 3).astype(np.float64)
        return (stored / 65534 * 2 - 1).astype(np.float32)

    @cached_property
    def part_id(self) -> NDArray[np.uint8]:
        """Parts (H, W): 1-16 the hand's joints, 17 forearm, 18 sleeve, 19 object, 0 none."""
        return self._image("labels", "part.png", 0)

    @cached_property
    def instance_id(self) -> NDArray[np.uint8]:
        """Instances (H, W): 0 background, then subjects, then ``objects``."""
        return self._image("labels", "instance.png", 0)

    @cached_property
    def stored_faces(self) -> NDArray[np.uint16]:
        """Face + 1 and its first two barycentrics x 65535, (H, W, 3), as stored."""
        return self._image("labels", "face.png", 3)

    @property
    def face_id(self) -> NDArray[np.int32]:
        """Face of the model's surface (hand, then arm) per pixel (H, W), -1 off hands."""
        return self.stored_faces[..., 0].astype(np.int32) - 1

    @property
    def barycentric(self) -> NDArray[np.float32]:
        """Barycentrics (H, W, 3) in that face; zero off hands; stored to 1e-5."""
        first = self.stored_faces[..., 1:].astype(np.float64) / 65535
        on = (self.stored_faces[..., :1] > 0).astype(np.float64)
        third = np.clip(1 - first.sum(axis=-1, keepdims=True), 0, 1) * on
        return np.concatenate([first, third], axis=-1).astype(np.float32)

    @cached_property
    def uv(self) -> NDArray[np.float32]:
        """Texture coordinates (H, W, 2) on hands, origin bottom left."""
        return (self._image("labels", "uv.png", 3)[..., :2] / 65535.0).astype(np.float32)

    @cached_property
    def camera(self) -> ViewCamera:
        """Calibration of this view."""
        m = self.meta
        return ViewCamera(
            K=np.array(m["K"], np.float64),
            T_world_from_camera=np.array(m["T_world_from_camera"], np.float64),
            distortion=np.array(m["distortion"], np.float64),
            width=m["width"],
            height=m["height"],
        )

    @cached_property
    def hands(self) -> tuple[HandView, ...]:
        """Labels per hand, in the order of the sample's subjects."""
        return tuple(_hand(row) for row in self.meta["hands"])

    @property
    def objects(self) -> list[dict[str, Any]]:
        """What is labelled beside hands: sleeves, rings, bracelets, watches, occluders.

        Each has ``instance_id``, ``part_id``, ``kind``, ``subject`` (who wears it, -1 nobody), and
        of what is seen of it ``box_xyxy`` and ``pixels``.
        """
        return list(self.meta["objects"])

    def _only(self) -> HandView:
        if len(self.hands) != 1:
            raise CorpusError(f"{self.key} shows {len(self.hands)} hands; use view.hands[j]")
        return self.hands[0]

    @property
    def keypoints_2d(self) -> NDArray[np.float32]:
        """Keypoints (21, 2) of the only hand, pixels."""
        return self._only().keypoints_2d

    @property
    def keypoints_3d(self) -> NDArray[np.float32]:
        """Keypoints (21, 3) of the only hand, camera frame, metres."""
        return self._only().keypoints_3d

    @property
    def keypoints_state(self) -> NDArray[np.uint8]:
        """States (21,) of the only hand's keypoints: 0 out, 1 occluded, 2 visible."""
        return self._only().keypoints_state


def _hand(row: dict[str, Any]) -> HandView:
    box = row["box_xyxy"]
    return HandView(
        hand=row["hand"],
        instance_id=row["instance_id"],
        keypoints_2d=np.array(row["keypoints_2d"], dtype=np.float32),
        keypoints_3d=np.array(row["keypoints_3d_m"], dtype=np.float32),
        keypoints_state=np.array(row["keypoints_state"], dtype=np.uint8),
        box_xyxy=None if box is None else (box[0], box[1], box[2], box[3]),
    )


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample: its views, its truth, and the spec it was made from."""

    index: int
    views: tuple[View, ...]
    spec: SampleSpec

    def __repr__(self) -> str:
        keys = ", ".join(view.key for view in self.views)
        return f"<Sample {self.index}: {len(self.spec.scene.subjects)} hand(s); views {keys}>"

    @cached_property
    def scan(self) -> Scan | None:
        """The scan of the hand, in the sample's world, or None where the corpus has no scanner."""
        from synthgen.corpus.scans import read_scan

        return read_scan(self.views[0].key, self.views[0].stored_member)

    @cached_property
    def subjects(self) -> list[Subject]:
        """The truth of every hand."""
        made_with = [hand["model_digest"] for hand in self.views[0].meta["hands"]]
        subjects = self.spec.scene.subjects
        return [Subject(s, digest) for s, digest in zip(subjects, made_with, strict=True)]

    @property
    def truth(self) -> Subject:
        """The truth of the only hand.

        Raises
        ------
        CorpusError
            If the sample shows several.
        """
        if len(self.subjects) != 1:
            raise CorpusError(
                f"sample {self.index} has {len(self.subjects)} subjects; use .subjects"
            )
        return self.subjects[0]
