"""From a checked file to a model."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, ShapeError
from synthgen.models import joints as tables
from synthgen.models.constrained import ConstrainedTree
from synthgen.models.content import Array, Content, digest_of
from synthgen.models.families import NEEDED, parents_of, posedirs_of
from synthgen.models.finding import is_shipped
from synthgen.models.left_shape import left_shapedirs
from synthgen.models.loft import loft_surface
from synthgen.models.mano import ManoModel
from synthgen.models.model import BodyModel, Hand, HandSpace
from synthgen.models.shipped import hand_surface

Ids = NDArray[np.int64]
_LICENCE = (
    "your own file, under its own licence (published MANO, SMPL+H, SUPR and STAR files: "
    "Max Planck non-commercial research licence; do not pass the file on)"
)


def build_hand(content: Content, *, official_left_shape: bool) -> ManoModel:
    """Make a hand of a checked MANO-form file.

    Parameters
    ----------
    content : Content
        Of family "mano".
    official_left_shape : bool
        Keep a published left hand's shape bases as they are.

    Raises
    ------
    ModelError
        If its mesh has no single open wrist, or fingertips are no vertices of it.
    """
    side = side_of(content)
    shapes, done = content.owned("shapedirs"), "right hand"
    if side == "left":
        shapes, done, words = left_shapedirs(content, shapes, official=official_left_shape)
        if done == "mended":
            mended = content.having(shapedirs=shapes)
            content = replace(mended, digest=digest_of(mended, NEEDED))
        content = replace(content, warnings=(*content.warnings, *words))
    arrays = _arrays(content, tables.MANO16_NAMES)
    v, faces, weights = arrays["v_template"], arrays["faces"], arrays["weights"]
    rest = arrays["J_regressor"] @ v
    tips, tip_set = _hand_tips(content, v, weights, rest)
    try:
        surface = (
            hand_surface(content, weights, faces)
            if "arm_template" in content.arrays
            else loft_surface(v, shapes, faces, weights, rest, tips)
        )
    except (ShapeError, ModelError) as error:
        raise content.fail(f"f: {error}") from None
    return ManoModel(
        **{**arrays, "shapedirs": shapes},
        hand=side,
        hands_mean=content.owned("hands_mean"),
        hands_components=content.owned("hands_components"),
        hands_coeffs=content.optional("hands_coeffs"),
        fingertip_ids=tips,
        fingertip_set=tip_set,
        joint_axes=content.optional("joint_axes"),
        joint_range=content.optional("joint_range"),
        finger_radius=_finger_radius(v, weights, rest),
        surface=surface,
        provenance=_provenance(content, left_shape=done),
    )


def build_body(content: Content) -> BodyModel:
    """Make a body, or a part of one, of a checked SMPL+H, SUPR or STAR file."""
    v, k = content.arrays["weights"].shape
    arrays = _arrays(content, joint_names(content, k))
    tree = None if content.meta is None else ConstrainedTree.from_meta(content.meta, k)
    tips, tip_set = _body_tips(content, arrays)
    return BodyModel(
        **arrays,
        exprdirs=content.optional("exprdirs"),
        hands_left=_space(content, "l"),
        hands_right=_space(content, "r"),
        fingertip_ids=tips,
        fingertip_set=tip_set,
        landmark_ids=_vertex_ids(content, "landmark_ids", 11)
        if "landmark_ids" in content.arrays
        else np.array(tables.LANDMARKS.get(v, ()), dtype=np.int64),
        vert_sym_idxs=content.ids("vert_sym_idxs") if "vert_sym_idxs" in content.arrays else None,
        part_ids=_part_ids(content, v),
        axis_meta=tree,
        provenance=_provenance(content),
    )


def side_of(content: Content) -> Hand:
    """Return the side of a hand's file: its key ``hand``, else LEFT in its name, else right."""
    named = content.text("hand")
    if named in ("left", "right"):
        return "left" if named == "left" else "right"
    return "left" if "left" in content.path.stem.lower() else "right"


def joint_names(content: Content, k: int) -> tuple[str, ...]:
    """Return joint names: those in the file, else those of the published order of that count.

    Raises
    ------
    ModelError
        If the file's own are not one name per joint, all different.
    """
    own = content.arrays.get("joint_names")
    if own is not None:
        if own.dtype.kind not in "US" or own.shape != (k,) or len(np.unique(own)) != k:
            raise content.fail(
                f"joint_names is {own.shape} of {own.dtype}, {len(np.unique(own))} of them "
                f"different; expected {k} names, one per joint, all different"
            )
        return tuple(str(name) for name in own.astype(str))
    published: tuple[tuple[str, ...], ...] = {
        "smplh": (tables.SMPLH52_NAMES,),
        "supr": (tables.SUPR75_NAMES, tables.FOOT13_NAMES),
        "star": (tables.STAR24_NAMES,),
    }.get(content.family, ())
    for names in published:
        if len(names) == k:
            return names
    return tuple(f"joint{j}" for j in range(k))


def _arrays(content: Content, names: tuple[str, ...]) -> dict[str, Any]:
    """Return what every family has, as keyword arguments."""
    return {
        "name": content.path.stem if is_shipped(content.path) else str(content.path),
        "family": content.family,
        "digest": content.digest,
        "v_template": content.owned("v_template"),
        "shapedirs": content.owned("shapedirs"),
        "posedirs": posedirs_of(content),
        "weights": content.owned("weights"),
        "J_regressor": content.owned("J_regressor"),
        "parents": parents_of(content),
        "faces": content.ids("f"),
        "joint_names": names,
        "warnings": content.warnings,
    }


def _space(content: Content, side: str) -> HandSpace | None:
    mean, rows = (content.optional(f"hands_{part}{side}") for part in ("mean", "components"))
    if mean is None or rows is None:
        return None
    return HandSpace(mean, rows, content.optional(f"hands_coeffs{side}"))


def _vertex_ids(content: Content, key: str, count: int) -> Ids:
    shape, v = content.arrays[key].shape, len(content.arrays["v_template"])
    if shape != (count,):
        raise content.fail(f"{key} is {shape}; expected ({count},), that many of {v} vertices")
    ids = content.ids(key)
    if ids.min() < 0 or ids.max() >= v:
        raise content.fail(f"{key} {ids.tolist()} are not {count} of {v} vertices")
    return ids


def _part_ids(content: Content, v: int) -> dict[str, Ids]:
    found = {k.removeprefix("part_"): content.ids(k) for k in content.arrays
             if k.startswith("part_") and content.arrays[k].ndim == 1}  # fmt: skip
    for part, ids in found.items():
        if not len(ids) or ids.min() < 0 or ids.max() >= v:
            raise content.fail(f"part_{part} refers to vertices beyond the {v} of the body")
    return found


def _hand_tips(content: Content, v: Array, weights: Array, rest: Array) -> tuple[Ids, str]:
    if "fingertip_ids" in content.arrays:
        return _vertex_ids(content, "fingertip_ids", 5), content.path.stem
    if len(v) == 778:
        return np.array(tables.MANO778_TIPS["smplx"], dtype=np.int64), "smplx"
    chains = [(3 * tables.FINGERS.index(f) + 2, 3 * tables.FINGERS.index(f) + 3)
              for f in tables.TIP_ORDER]  # fmt: skip
    return _farthest(v, weights, rest, chains), "farthest-along-last-bone"


def _body_tips(content: Content, arrays: dict[str, Any]) -> tuple[Ids, str]:
    """Ten fingertips of a whole body; none where it has no fingers."""
    names, v = arrays["joint_names"], arrays["v_template"]
    if "fingertip_ids" in content.arrays:
        return _vertex_ids(content, "fingertip_ids", 10), content.path.stem
    if not set(tables.SMPLH52_NAMES) <= set(names):
        return np.zeros(0, dtype=np.int64), ""
    if len(v) in tables.BODY_TIPS:
        return np.array(tables.BODY_TIPS[len(v)], dtype=np.int64), "smplx"
    chains = [
        (names.index(f"{side}_{finger}2"), names.index(f"{side}_{finger}3"))
        for side in tables.SIDES
        for finger in tables.TIP_ORDER
    ]
    rest = _rest_joints(arrays)
    return _farthest(v, arrays["weights"], rest, chains), "farthest-along-last-bone"


def _rest_joints(arrays: dict[str, Any]) -> Array:
    v, regressor = arrays["v_template"], arrays["J_regressor"]
    if arrays["family"] == "supr":
        return np.asarray(regressor[:, :-1] @ v.ravel() + regressor[:, -1]).reshape(-1, 3)
    return np.asarray(regressor @ v)


def _farthest(v: Array, weights: Array, rest: Array, chains: list[tuple[int, int]]) -> Ids:
    """Return, per (joint before, last joint), the last one's vertex farthest along that bone."""
    owner = weights.argmax(axis=1)
    along = [(v - rest[last]) @ (rest[last] - rest[before]) for before, last in chains]
    ends = [np.where(owner == last, a, -np.inf).argmax() for a, (_, last) in zip(along, chains)]  # noqa: B905
    return np.array(ends, dtype=np.int64)


def _finger_radius(v: Array, weights: Array, joints: Array) -> Array:
    """Median distance from each joint of the skin that it moves most, near the joint."""
    owner = weights.argmax(axis=1)
    radius = np.full(len(joints), 0.012)
    for k in range(len(joints)):
        away = np.linalg.norm(v[owner == k] - joints[k], axis=1)
        if len(away) >= 8:
            radius[k] = float(np.quantile(away, 0.25))
    return radius


def _provenance(content: Content, **more: Any) -> str:
    """Return a file's own provenance, or (JSON) what is known about a user's file."""
    if "provenance" in content.arrays:
        return content.text("provenance")
    known = {
        "file": content.path.name,
        "sha256": content.sha256,
        "licence": _LICENCE,
        **more,
        "warnings": list(content.warnings),
    }
    return json.dumps(known, sort_keys=True)
