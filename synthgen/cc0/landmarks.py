"""Named vertices and vertex sets of the body: keypoints, parts, nails and lips."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.foundation import Foundation
from synthgen.cc0.skeleton import SUPR75
from synthgen.models.joints import FINGERS

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

# Colours in the segmentation image: skin, mouth and eye sockets make the head.
_PART_COLOURS = {
    "head": ((90, 86, 255), (112, 172, 255), (249, 108, 136), (253, 249, 16)),
    "left_hand": ((7, 255, 0),), "right_hand": ((255, 29, 35),),
    "left_foot": ((254, 251, 251),), "right_foot": ((255, 0, 245),),
}  # fmt: skip
_MASKS = {
    "mask_nail": ("mpfb_fingernails", "mpfb_toenails"),
    "mask_lips": ("mpfb_lips",),
}
_THUMB_FIRST = ("thumb", "index", "middle", "ring", "pinky")


def keypoints(base: Foundation) -> dict[str, Any]:
    """Vertices of the 21 points that SMPL+H libraries add to the joints, in their order.

    ``landmark_ids``: nose, eyes, ears, then toes and heel of the left and the right foot, by
    place; ``fingertip_ids``: thumb to pinky, left then right, those of the hand model. Besides
    ``vert_sym_idxs``, every vertex' counterpart.
    """
    points = base.template[: base.cut.n_body]
    joints = dict(zip(SUPR75.names, base.bodies.regressor @ points, strict=True))
    mirror = base.cut.mirror
    skull = points[:, 1] > joints["head"][1]
    middle = (np.abs(points[:, 0]) < 1e-6) & (points[:, 1] > joints["jaw"][1] - 0.02)
    found = {"nose": _farthest(points, middle, (0, 0, 1))}
    right = points[:, 0] < 0
    found["right_eye"] = _nearest(points, joints["right_eye"] + [0, 0, 0.015])
    found["right_ear"] = _farthest(points, skull, (-1, 0, 0))
    foot = right & (points[:, 1] < joints["right_ankle"][1])
    for toe in ("bigtoe", "pinkytoe"):
        near = np.linalg.norm(points - joints[f"right_{toe}2"], axis=1) < 0.035
        away = joints[f"right_{toe}2"] - joints[f"right_{toe}1"]
        side = np.abs(points[:, 0] - joints[f"right_{toe}2"][0]) < 0.012
        found[f"right_{toe}"] = _farthest(points, foot & near & side, away)
    found["right_heel"] = _farthest(points, foot, (0, -0.3, -1))
    for finger, row in zip(_THUMB_FIRST, base.hand.fingertip_ids, strict=True):
        found[f"right_{finger}"] = int(base.cut.hand_ids[row])
    for name, vertex in list(found.items()):
        if name.startswith("right_"):
            found["left_" + name.removeprefix("right_")] = int(mirror[vertex])
    landmarks = [
        "nose", "right_eye", "left_eye", "right_ear", "left_ear",
        *(f"{side}_{p}" for side in ("left", "right") for p in ("bigtoe", "pinkytoe", "heel")),
    ]  # fmt: skip
    tips = [f"{side}_{finger}" for side in ("left", "right") for finger in _THUMB_FIRST]
    return {
        "landmark_ids": np.array([found[name] for name in landmarks], dtype=np.int64),
        "fingertip_ids": np.array([found[name] for name in tips], dtype=np.int64),
        "vert_sym_idxs": mirror[: base.cut.n_body].astype(np.int32),
    }


def _farthest(points: Array, where: NDArray[np.bool_], direction: Any) -> int:
    return int(np.where(where, points @ np.asarray(direction, dtype=np.float64), -np.inf).argmax())


def _nearest(points: Array, place: Array) -> int:
    return int(np.linalg.norm(points - place, axis=1).argmin())


def parts(base: Foundation) -> dict[str, Ints]:
    """Vertex lists of head, hands and feet from the segmentation image; sides mirror each other."""
    image = base.source.image("segmentation/body_parts_segmentation.png")
    body = base.source.groups["body"]
    middle = base.source.texture[body.texture].mean(axis=1)
    size = image.shape[0]
    rows = np.clip(np.round((1 - middle[:, 1]) * size).astype(int), 0, size - 1)
    columns = np.clip(np.round(middle[:, 0] * size).astype(int), 0, size - 1)
    colour = image[rows, columns]
    found = {}
    for name, codes in _PART_COLOURS.items():
        own = np.any([np.all(colour == code, axis=1) for code in codes], axis=0)
        found[name] = np.unique(body.vertices[own])
    return found


def masks(base: Foundation) -> dict[str, NDArray[np.uint8]]:
    """Nails and lips as MakeHuman's textures paint them, at vertices, 0-255."""
    n = base.cut.n_body
    texture = np.zeros(n, dtype=np.int64)
    texture[base.cut.faces.ravel()] = base.cut.texture.ravel()
    uv = base.source.texture[texture]
    result = {}
    for key, names in _MASKS.items():
        total = np.zeros(n)
        for name in names:
            image = base.source.image(f"mpfb2/textures/{name}.jpg")[..., 0]
            size = np.array(image.shape)
            rows = np.clip(((1 - uv[:, 1]) * size[0]).astype(int), 0, size[0] - 1)
            columns = np.clip((uv[:, 0] * size[1]).astype(int), 0, size[1] - 1)
            total = np.maximum(total, image[rows, columns])
        symmetric = np.maximum(total, total[base.cut.mirror[:n]])
        result[key] = symmetric.astype(np.uint8)
    return result


def fingers_of(side: str) -> list[str]:
    """Names of a hand's 15 finger joints in MANO order."""
    return [f"{side}_{finger}{k}" for finger in FINGERS for k in (1, 2, 3)]
