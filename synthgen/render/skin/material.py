"""Skin as Mitsuba draws it: the material of each quality and what fills its parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models import ManoModel
from synthgen.render.skin import plain
from synthgen.scene import HandSubject, Skin

Values = dict[str, NDArray[np.float32] | float]


def describe(mi: Any, quality: str) -> dict[str, Any]:
    """Return the material's description with empty textures, filled later by name.

    Parameters
    ----------
    mi : module
        Mitsuba with an active variant.
    quality : {"plain", "full"}
    """
    return {
        "type": "principled",
        "base_color": _bitmap(mi, plain.TEXTURE_PX, 3),
        "roughness": {"type": "uniform", "value": 0.5},
        "specular": 0.45,
    }


def of_skin(model: ManoModel, skin: Skin, quality: str) -> Values:
    """Return what changes with the person: parameter below ``bsdf`` -> texture or number."""
    return {"base_color.data": plain.bake(model, skin), "roughness.value": skin.roughness}


def of_pose(model: ManoModel, subject: HandSubject, quality: str) -> Values:
    """Return what changes with the pose: the height map, metres; nothing in quality plain."""
    return {}


def _bitmap(mi: Any, size: int, channels: int) -> dict[str, Any]:
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.full((size, size, channels), 0.4, dtype=np.float32)),
        "filter_type": "bilinear",
        "wrap_mode": "clamp",
        "raw": True,
    }
