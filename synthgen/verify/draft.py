"""Some samples of a corpus, open to change, and stored again as a corpus of their own.

What a fault spoils is what a user would read: members are decoded, changed and encoded again, with
sound checksums, so that the judges see a corpus like any other.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.corpus import Corpus, manifest, shards
from synthgen.corpus.checksums import CONFIG
from synthgen.corpus.columns import Members, decode_image, depth_steps, key_of, png
from synthgen.corpus.plan import ENGINE, PLAN
from synthgen.corpus.sample import View
from synthgen.corpus.scans import npy, read_npy
from synthgen.scanner import Scan
from synthgen.scanner.files import ply_bytes

JPEG_QUALITY = 98


def _jpeg(image: NDArray[Any]) -> bytes:
    bgr = np.ascontiguousarray(image[..., ::-1])
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())


def _depth(depth_z_m: NDArray[Any]) -> bytes:
    return png(depth_steps(depth_z_m))


def _normals(normals: NDArray[Any]) -> bytes:
    return png(np.rint((normals.astype(np.float64) + 1) / 2 * 65534).astype(np.uint16))


def _uv(uv: NDArray[Any]) -> bytes:
    three = np.zeros((*uv.shape[:2], 3), np.uint16)
    three[..., :2] = np.rint(np.clip(uv, 0, 1).astype(np.float64) * 65535)
    return png(three)


# Array of a view: its column, its member, how it is encoded.
STORED: dict[str, tuple[str, str, Callable[[NDArray[Any]], bytes]]] = {
    "image": ("image", "jpg", _jpeg),
    "depth_z_m": ("depth", "depth.png", _depth),
    "instance_id": ("labels", "instance.png", png),
    "part_id": ("labels", "part.png", png),
    "normals": ("labels", "normals.png", _normals),
    "uv": ("labels", "uv.png", _uv),
    "stored_faces": ("labels", "face.png", png),
}


# Array of a unit's pair: its member.
UNIT_ARRAYS = {"left.png": "left.png", "right.png": "right.png", "disparity": "disparity.npy",
               "true": "true.npy"}  # fmt: skip


class ViewDraft:
    """One view: ``meta`` and the arrays of :data:`STORED`, by name, may be changed."""

    def __init__(self, view: View) -> None:
        self._view = view
        self.meta: dict[str, Any] = copy.deepcopy(view.meta)
        self._changed: dict[str, NDArray[Any]] = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        found: NDArray[Any] = self._changed.get(name, getattr(self._view, name))
        return found

    def __setitem__(self, name: str, values: NDArray[Any]) -> None:
        if not np.array_equal(values, self[name]):
            self._changed[name] = np.ascontiguousarray(values)

    def __contains__(self, name: str) -> bool:
        return STORED[name][0] in self._view.columns

    @property
    def distance_m(self) -> NDArray[np.float32]:
        """Distance from the camera's centre (H, W), from the untouched depth."""
        return self._view.distance_m

    @property
    def changed(self) -> bool:
        """Whether anything differs from what was stored."""
        return bool(self._changed) or self.meta != self._view.meta

    def members(self) -> dict[str, Members]:
        """Encode what was changed: ``{column: {member name: bytes}}``."""
        key, found = self._view.key, {}
        if self.meta != self._view.meta:
            found["meta"] = {f"{key}.json": json.dumps(self.meta, allow_nan=False).encode()}
        for name, values in self._changed.items():
            column, suffix, encode = STORED[name]
            found.setdefault(column, {})[f"{key}.{suffix}"] = encode(values)
        return found


class UnitDraft:
    """One unit's rectified pair: its arrays, and by their names the facts about it.

    Arrays are those of :data:`UNIT_ARRAYS`; ``facts`` are the member ``KEY.UNIT.json``.
    """

    def __init__(self, name: str, members: Members) -> None:
        self._name = name
        self._stored: dict[str, Any] = json.loads(members[f"{name}.json"])
        self.facts = copy.deepcopy(self._stored)
        self._arrays = {
            array: _decoded(members[f"{name}.{member}"], member)
            for array, member in UNIT_ARRAYS.items()
        }
        self._changed: set[str] = set()

    def __getitem__(self, name: str) -> Any:
        return self._arrays[name] if name in UNIT_ARRAYS else self.facts[name]

    def __setitem__(self, name: str, value: Any) -> None:
        if name not in UNIT_ARRAYS:
            self.facts[name] = value
        elif not np.array_equal(value, self._arrays[name], equal_nan=True):
            self._arrays[name] = value
            self._changed.add(name)

    def members(self) -> Members:
        """Encode what was changed."""
        found: Members = {}
        for name in sorted(self._changed):
            encode = png if name.endswith(".png") else npy
            found[f"{self._name}.{UNIT_ARRAYS[name]}"] = encode(self._arrays[name])
        if self.facts != self._stored:
            found[f"{self._name}.json"] = json.dumps(self.facts, allow_nan=False).encode()
        return found


def _decoded(data: bytes, member: str) -> NDArray[Any]:
    return decode_image(data, member) if member.endswith(".png") else read_npy(data, member)


class Draft:
    """One sample: its views, its ``units`` and ``scan`` may be changed."""

    def __init__(self, corpus: Corpus, position: int) -> None:
        self._corpus, self._position = corpus, position
        self.sample = corpus[position]
        self.views = [ViewDraft(view) for view in self.sample.views]
        self._scan: Scan | None = None
        self._stand_in: Scan | None = None
        self._foreign: dict[str, Members] = {}
        self._units: dict[str, UnitDraft] = {}

    @property
    def scan(self) -> Scan | None:
        """The scan, as stored or as set."""
        own = self.sample.scan if self._stand_in is None else self._stand_in
        return own if self._scan is None else self._scan

    @scan.setter
    def scan(self, scan: Scan) -> None:
        self._scan = scan

    def stand_in(self, scan: Scan) -> None:
        """Let a scan stand for one that the corpus lacks: no change, but stored with the rest."""
        self._stand_in = scan

    @cached_property
    def stored(self) -> dict[str, Members]:
        """All members as they are stored."""
        return self._corpus.stored(self._position)

    @property
    def units(self) -> dict[str, UnitDraft]:
        """The rectified pairs of a scan, by unit; none where the corpus stores none."""
        members, key = self.stored.get("stereo", {}), self.views[0].meta["key"]
        if not self._units:
            names = [n.removesuffix(".json") for n in members if n.endswith(".json")]
            self._units = {name.removeprefix(f"{key}."): UnitDraft(name, members) for name in names}
        return self._units

    @property
    def T_world_from_rig(self) -> NDArray[np.float64]:
        """Where the scanner stood (4, 4), as stored beside the scan."""
        key = self.views[0].meta["key"]
        return np.array(json.loads(self.stored["scan"][f"{key}.scan.json"])["T_world_from_rig"])

    @property
    def changed(self) -> bool:
        """Whether anything differs from what was stored."""
        return (
            bool(self._foreign)
            or self._scan is not None
            or any(v.changed for v in self.views)
            or any(unit.members() for unit in self._units.values())
        )

    def label_as(self, other: Draft) -> None:
        """Take labels and truth of another sample under the own name; measurements stay."""
        if other.sample.index == self.sample.index:
            return  # a corpus of one sample has no next one
        for own, foreign in zip(self.views, other.views, strict=True):
            index = self.sample.index
            spec = {**foreign.meta["spec"], "index": index}
            own.meta = {**copy.deepcopy(foreign.meta), "key": own.meta["key"], "spec": spec}
        mine, theirs = (key_of(d.sample.index, 0)[:-2] for d in (self, other))
        labels = other.stored.get("labels", {})
        self._foreign = {"labels": {mine + n.removeprefix(theirs): d for n, d in labels.items()}}

    def members(self, columns: Sequence[str]) -> dict[str, Members]:
        """Encode some columns: stored bytes, and what was changed in their place."""
        found = {column: dict(self.stored.get(column, {})) for column in columns}
        changes = [self._foreign, *(view.members() for view in self.views)]
        changes += [{"stereo": unit.members()} for unit in self._units.values()]
        key, scan = self.views[0].meta["key"], self._scan
        if self._stand_in is not None:
            scan = self._stand_in if scan is None else scan
            changes.append({"scan": _whole(scan, key)})
        elif scan is not None:
            changes.append({"scan": {f"{key}.scan.ply": ply_bytes(scan)}})
        for change in changes:
            for column in set(change) & set(columns):
                found[column] |= change[column]
        return found


def _whole(scan: Scan, key: str) -> Members:
    """Encode a scan with all of its members."""
    facts: dict[str, Any] = {"level": scan.level, "units": []}
    return {
        f"{key}.scan.ply": ply_bytes(scan),
        f"{key}.texture.jpg": _jpeg(scan.texture),
        f"{key}.corner_uv.npy": npy(scan.corner_uv.astype(np.uint16)),
        f"{key}.scan.json": json.dumps(facts).encode(),
    }


def write_drafts(
    corpus: Corpus, drafts: Sequence[Draft], columns: Sequence[str], out: Path
) -> None:
    """Store drafts as a corpus with these columns, one shard, at an empty folder."""
    out.mkdir(parents=True, exist_ok=True)
    for name in (ENGINE, CONFIG):
        (out / name).write_bytes((corpus.path / name).read_bytes())
    rows = [json.dumps(draft.views[0].meta["spec"]) for draft in drafts]
    (out / PLAN).write_text("".join(row + "\n" for row in rows), encoding="utf-8")
    for folder in (shards.SIDECARS, *columns):
        (out / folder).mkdir(exist_ok=True)
    with shards.ShardWriter(out, 0, tuple(columns)) as writer:
        for draft in drafts:
            for column, members in draft.members(columns).items():
                writer.add(column, members)
        writer.commit({"samples": [d.sample.index for d in drafts], "redrawn": {}})
    manifest.write_manifest(out)
