"""Files of models that no file holds: the other hand, or a part of a body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models.build import build_body, build_hand
from synthgen.models.content import Content
from synthgen.models.mano import ManoModel
from synthgen.models.mirror import mirror_model
from synthgen.models.model import BodyModel, Hand
from synthgen.models.parts import PartName, separate


def hand_content(content: Content, hand: Hand) -> Content:
    """Return the file of one side of a hand; the other side is mirrored, its bases mended.

    Raises
    ------
    ModelError
        If the content is no hand.
    """
    if content.family != "mano":
        raise content.fail(f"family {content.family} is no hand; a side is chosen of MANO files")
    own = build_hand(content, official_left_shape=False)
    if own.hand == hand:
        return content.having(hand=np.array(hand), shapedirs=own.shapedirs)
    model = mirror_model(own)
    found: dict[str, NDArray[Any] | None] = {
        "hand": np.array(hand),
        "v_template": model.v_template,
        "shapedirs": model.shapedirs,
        "posedirs": model.posedirs,
        "f": model.faces.astype(content.arrays["f"].dtype),
        "hands_mean": model.hands_mean,
        "hands_components": model.hands_components,
        "joint_axes": model.joint_axes,
        "J": model.J_regressor @ model.v_template,
        **_arm(model),
    }
    kept = {
        k: a for k, a in found.items() if a is not None and (k in content.arrays or k == "hand")
    }
    return content.having(**kept)


def _arm(model: ManoModel) -> dict[str, NDArray[Any] | None]:
    """Keys of a shipped hand's drawn surface that have a side."""
    surface = model.surface
    return {
        "arm_template": surface.arm.template,
        "arm_shapedirs": surface.arm.shapedirs,
        "arm_elbow": surface.arm.elbow,
        "arm_elbow_shapedirs": surface.arm.elbow_shapedirs,
        "arm_faces": surface.arm.faces,
        "uv_faces": surface.uv_faces,
    }


def part_content(content: Content, part: PartName) -> Content:
    """Return the file of a part of a body (:func:`synthgen.models.parts.separate`).

    Its joints come from a regressor of the part's own vertices, which agrees with the body's for
    every shape to rounding.

    Raises
    ------
    ModelError
        If the content is no body, or the body has no such part.
    """
    if content.family == "mano":
        raise content.fail("is a hand already; a part is separated from a body")
    body = build_body(content)
    cut = separate(body, part)
    arrays = {**_published(cut.model), "body_vertex_ids": cut.vertex_ids}
    for key in ("bs_style", "bs_type", "provenance"):
        if key in content.arrays:
            arrays[key] = content.arrays[key]
    meta = None if cut.model.axis_meta is None else cut.model.axis_meta.to_meta()
    path = Path(f"{content.path.stem}_{part}{content.path.suffix}")
    return replace(content, path=path, arrays=arrays, meta=meta)


def _published(model: BodyModel) -> dict[str, NDArray[Any]]:
    arrays = {
        "family": np.array(model.family),
        "v_template": model.v_template,
        "shapedirs": model.shapedirs,
        "posedirs": model.posedirs,
        "weights": model.weights,
        "J_regressor": model.J_regressor,
        "kintree_table": np.stack([model.parents, np.arange(len(model.parents))]),
        "f": model.faces.astype(np.uint32),
        "joint_names": np.array(model.joint_names),
    }
    if model.exprdirs is not None:
        arrays["exprdirs"] = model.exprdirs
    for side, space in (("l", model.hands_left), ("r", model.hands_right)):
        if space is not None:
            arrays |= {f"hands_mean{side}": space.mean, f"hands_components{side}": space.components}
            if space.coeffs is not None:
                arrays[f"hands_coeffs{side}"] = space.coeffs
    return arrays
