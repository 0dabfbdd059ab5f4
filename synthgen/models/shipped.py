"""What shipped files hold beyond the published keys, and how it is stored.

Shipped models use the published key names, so that one reader reads them and users' files. Whole
bodies come in the form of :mod:`synthgen.models.compact`; in a hand ``KEY_q`` (int16 or int8)
times ``KEY_scale`` (a number, or one that broadcasts) stands for ``KEY``. Extra keys describe
what published files lack: ``joint_names``, ``fingertip_ids``, ``landmark_ids``, ``part_*`` (vertex
ids), ``joint_axes``, ``joint_range``, ``uv``, ``arm_*``, ``mask_*``. What else is there
(``garment_*``, ``eyes_*``, ``lashes_*``, ``foot_*``, ...) is read by those who use it through
:func:`shipped_extras`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models import compact
from synthgen.models.content import Content, read_content
from synthgen.models.finding import find
from synthgen.models.surface import Arm, HandSurface

_PUBLISHED: Final = frozenset(
    (
        *("v_template", "shapedirs", "exprdirs", "posedirs", "weights", "J_regressor", "f", "J"),
        *("kintree_table", "bs_style", "bs_type"),
        *(f"hands_{key}{s}" for key in ("mean", "components", "coeffs") for s in ("", "l", "r")),
    )
)


def decoded(content: Content) -> Content:
    """Return a file's content with what is stored compactly written out; others pass unchanged.

    Raises
    ------
    ModelError
        If a scale or another part of the compact form is missing or does not fit, or the numbers
        would fill memory.
    """
    content.check_size()
    arrays = content.arrays
    if compact.is_shipped(arrays):
        try:
            arrays = compact.expand(arrays)
        except (ModelError, ValueError, IndexError, TypeError) as error:
            raise content.fail(f"its compact form does not fit together ({error})") from None
    result = {k: v for k, v in arrays.items() if not _is_quantised(k, v)}
    for key, integers in arrays.items():
        if _is_quantised(key, integers):
            name = key.removesuffix("_q")
            try:
                result[name] = compact.scaled(integers, arrays[f"{name}_scale"])
            except (KeyError, ValueError):
                raise content.fail(f"{name}_scale is missing or does not fit {key}") from None
            result.pop(f"{name}_scale", None)
    result.pop("shipped_form", None)  # what is written out again is compact no longer
    return replace(content, arrays=result)


def _is_quantised(key: str, array: NDArray[Any]) -> bool:
    return key.endswith("_q") and array.dtype.kind == "i"


def shipped_extras(name: str | Path) -> MappingProxyType[str, NDArray[Any]]:
    """Return what a model's file holds beyond the keys of published files, decoded.

    Parameters
    ----------
    name : str or Path
        A model's name or path.

    Returns
    -------
    mapping of str to array
        Garments, eyes, parts, foot networks, masks, ...
    """
    path = find(name)
    return _extras(str(path), path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _extras(path: str, stamp: int) -> MappingProxyType[str, NDArray[Any]]:
    arrays = decoded(read_content(Path(path))).arrays
    return MappingProxyType({k: v for k, v in arrays.items() if k not in _PUBLISHED})


def hand_surface(content: Content, weights: NDArray[Any], faces: NDArray[np.int64]) -> HandSurface:
    """Return the drawn surface that a shipped hand brings.

    Raises
    ------
    ModelError
        If one of its keys is missing.
    """
    get = content.owned
    arm = Arm(
        template=get("arm_template"),
        shapedirs=get("arm_shapedirs"),
        weights=get("arm_weights"),
        elbow=get("arm_elbow"),
        elbow_shapedirs=get("arm_elbow_shapedirs"),
        faces=content.ids("arm_faces"),
        end_ids=content.ids("arm_end_ids"),
    )
    part = np.full(len(weights) + len(arm.template), 17, dtype=np.uint8)
    part[: len(weights)] = weights.argmax(axis=1) + 1
    return HandSurface(
        arm,
        np.concatenate([faces, arm.faces]),
        get("uv"),
        content.ids("uv_faces"),
        get("mask_nail"),
        get("mask_palm"),
        part,
    )
