"""What shipped files hold beyond the published keys, and how it is stored.

Shipped models use the published key names, so that one reader reads them and users' files. Large
arrays are quantised: ``KEY_q`` (int16 or int8) times ``KEY_scale`` (a number, or one that
broadcasts) stands for ``KEY``. Extra keys describe what published files lack: ``joint_names``,
``fingertip_ids``, ``landmark_ids``, ``joint_axes``, ``joint_range``, ``uv``, ``arm_*``, ``mask_*``
for drawn hands; ``garment_*``, ``eyes_*``, ``lashes_*``, ``part_*``, ``foot_*`` for bodies, read
by those who use them through :func:`shipped_extras`.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models.content import Content, read_content
from synthgen.models.finding import find
from synthgen.models.surface import Arm, HandSurface

EXTRA_PREFIXES = ("garment_", "eyes_", "lashes_", "part_", "foot_")


def dequantised(content: Content) -> Content:
    """Return the content with every ``KEY_q`` turned into its float ``KEY``.

    Raises
    ------
    ModelError
        If the scale is missing or does not fit.
    """
    result = {k: v for k, v in content.arrays.items() if not _is_quantised(content, k)}
    for key in content.arrays:
        if _is_quantised(content, key):
            name = key.removesuffix("_q")
            try:
                values = content.numbers(key) * content.numbers(f"{name}_scale")
            except ValueError:
                raise content.fail(f"{name}_scale does not fit {key}") from None
            result[name] = values
            result.pop(f"{name}_scale", None)
    return Content(content.path, result, content.meta, warnings=content.warnings)


def _is_quantised(content: Content, key: str) -> bool:
    return key.endswith("_q") and content.arrays[key].dtype.kind == "i"


def shipped_extras(name: str | Path) -> MappingProxyType[str, NDArray[Any]]:
    """Return the extra arrays of a model's file (garments, eyes, parts, ...), dequantised.

    Parameters
    ----------
    name : str or Path
        A model's name or path.

    Returns
    -------
    mapping of str to array
        Keys that start with one of ``EXTRA_PREFIXES``; empty for published files.
    """
    path = find(name)
    return _extras(str(path), path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _extras(path: str, stamp: int) -> MappingProxyType[str, NDArray[Any]]:
    arrays = dequantised(read_content(Path(path))).arrays
    return MappingProxyType({k: v for k, v in arrays.items() if k.startswith(EXTRA_PREFIXES)})


def hand_surface(content: Content, weights: NDArray[Any], faces: NDArray[np.int64]) -> HandSurface:
    """Return the drawn surface that a shipped hand brings.

    Raises
    ------
    ModelError
        If one of its keys is missing.
    """
    get = content.numbers
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
