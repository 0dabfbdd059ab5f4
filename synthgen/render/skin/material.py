"""Skin as Mitsuba draws it: the material of each quality and what fills its parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models import ManoModel
from synthgen.render.skin import plain
from synthgen.render.skin.albedo import albedo
from synthgen.render.skin.bake import bake
from synthgen.render.skin.surface import gloss, height_m
from synthgen.scene import HandSubject, Skin
from synthgen.scene.anatomy import flexion_rad

Values = dict[str, NDArray[np.float32] | float]

# Pictures up to this size hold no more detail than the smaller atlas.
_SMALL_PX, _SMALL, _LARGE = 320, 1024, 2048


def atlas_size(quality: str, picture_px: int) -> int:
    """Return the edge of the skin's textures, texels, for a picture's longer side."""
    if quality == "plain":
        return plain.TEXTURE_PX
    return _SMALL if picture_px <= _SMALL_PX else _LARGE


def describe(mi: Any, quality: str, size: int) -> dict[str, Any]:
    """Return the material's description with empty textures, filled later by name.

    Parameters
    ----------
    mi : module
        Mitsuba with an active variant.
    quality : {"plain", "full"}
    size : int
        Edge of the textures, texels: :func:`atlas_size`.
    """
    if quality == "plain":
        return {
            "type": "principled",
            "base_color": _bitmap(mi, size, 3),
            "roughness": {"type": "uniform", "value": 0.5},
            "specular": 0.45,
        }
    skin = {
        "type": "principled",
        "base_color": _bitmap(mi, size, 3),
        "roughness": _bitmap(mi, size, 1),
        "specular": 0.34,
        "clearcoat": _bitmap(mi, size, 1),
        "clearcoat_gloss": 0.75,
    }
    # An object, not a description: who needs the relief's slope asks this very texture.
    relief = mi.load_dict(_bitmap(mi, size, 1))
    return {"type": "bumpmap", "bump": relief, "scale": 1.0, "bsdf": skin}


def of_skin(model: ManoModel, skin: Skin, quality: str, size: int) -> Values:
    """Return what changes with the person: parameter below ``bsdf`` -> texture or number."""
    if quality == "plain":
        return {"base_color.data": plain.bake(model, skin), "roughness.value": skin.roughness}
    maps = bake(model, size)
    rough, coat = gloss(maps, skin)
    return {
        "nested_bsdf.base_color.data": albedo(maps, skin),
        "nested_bsdf.roughness.data": rough,
        "nested_bsdf.clearcoat.data": coat,
    }


def of_pose(model: ManoModel, subject: HandSubject, quality: str, size: int) -> Values:
    """Return what changes with the pose: the height map, metres; nothing in quality plain."""
    if quality == "plain":
        return {}
    bent = flexion_rad(model, np.array(subject.pose))
    return {"nested_texture.data": height_m(bake(model, size), subject.skin, bent)}


def bumped_normal(mi: Any, dr: Any, hit: Any, relief: Any, active: Any) -> Any:
    """Return the shading normals of hits under a bump map, as Mitsuba's ``bumpmap`` has them.

    Parameters
    ----------
    mi, dr : module
    hit : mi.SurfaceInteraction3f
    relief : mi.Texture
        Height, metres.
    active : mask
    """
    n = hit.sh_frame.n
    slope = relief.eval_1_grad(hit, active)
    along_u = dr.fma(n, slope.x - dr.dot(n, hit.dp_du), hit.dp_du)
    along_v = dr.fma(n, slope.y - dr.dot(n, hit.dp_dv), hit.dp_dv)
    bumped = dr.normalize(dr.cross(along_u, along_v))
    return dr.select(dr.dot(hit.n, bumped) < 0, -bumped, bumped)


def _bitmap(mi: Any, size: int, channels: int) -> dict[str, Any]:
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.full((size, size, channels), 0.4, dtype=np.float32)),
        "filter_type": "bilinear",
        "wrap_mode": "clamp",
        "raw": True,
    }
