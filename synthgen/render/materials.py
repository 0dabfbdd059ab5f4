"""Mitsuba's meshes and materials of everything but skin: two kinds, matt and glossy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.render import backend, background, textures
from synthgen.render.solids import MOST_BANDS, repeated
from synthgen.sampling.things import MOST_BOXES, MOST_TURNED
from synthgen.scene.solids import BOX_TRIANGLES, BOX_VERTICES, TURNED_TRIANGLES, TURNED_VERTICES
from synthgen.scene.wear import BAND_TRIANGLES, BAND_VERTICES, SLEEVE_TRIANGLES, SLEEVE_VERTICES

# Names of the textures below a mesh's ``bsdf``.
DIFFUSE = "brdf_0.reflectance.data"
GLOSSY = ("brdf_0.base_color.data", "brdf_0.roughness.data", "brdf_0.metallic.data")


def mesh(
    mi: Any, name: str, n: int, triangles: NDArray[Any], uv: NDArray[Any], bsdf: Any,
    *, smooth: bool,
) -> Any:  # fmt: skip
    """Return an empty mesh of fixed topology: ``n`` vertices at the origin.

    ``bsdf`` is a description, or a material made before.
    """
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf) if isinstance(bsdf, dict) else bsdf
    made = mi.Mesh(
        name, n, len(triangles), has_vertex_normals=smooth, has_vertex_texcoords=True,
        props=properties,
    )  # fmt: skip
    params = mi.traverse(made)
    params["faces"] = np.asarray(triangles, dtype=np.uint32).ravel()
    params["vertex_positions"] = backend.aligned(np.zeros(3 * n))
    params["vertex_texcoords"] = flip_v(uv)
    params.update()
    made.set_id(name)
    return made


def flip_v(uv: NDArray[Any]) -> NDArray[np.float32]:
    """Mitsuba samples bitmaps with the first row at v = 0 for meshes filled by hand."""
    flipped = backend.aligned(uv)
    flipped[:, 1] = 1 - flipped[:, 1]
    return flipped.ravel()


def place_meshes(mi: Any) -> dict[str, Any]:
    """Wall and floor."""
    return {
        name: mesh(mi, name, 4 * n, background.quads(n), np.zeros((4 * n, 2)),
                   _matt(mi, textures.TEXTURE_PX), smooth=False)
        for name, n in (("wall", background.WALLS), ("floor", 1))
    }  # fmt: skip


def thing_meshes(mi: Any) -> dict[str, Any]:
    """Slots for a table, boxes and turned bodies."""
    atlas = textures.ATLAS_PX
    found = {}
    for name, most, n, triangles, size, wrap in (
        ("table", 1, BOX_VERTICES, BOX_TRIANGLES, textures.TEXTURE_PX, "repeat"),
        ("boxes", MOST_BOXES, BOX_VERTICES, BOX_TRIANGLES, atlas, "clamp"),
        ("turned", MOST_TURNED, TURNED_VERTICES, TURNED_TRIANGLES, atlas, "clamp"),
    ):
        found[name] = mesh(
            mi, name, most * n, repeated(triangles, n, most), np.zeros((most * n, 2)),
            _glossy(mi, (size, size), wrap), smooth=True,
        )  # fmt: skip
    return found


def worn_meshes(mi: Any, k: int) -> dict[str, Any]:
    """Slots for what subject ``k`` wears."""
    n = MOST_BANDS * BAND_VERTICES
    bands = _glossy(mi, (2, textures.BAND_CELLS), "clamp", metallic=True)
    return {
        f"sleeve{k}": mesh(mi, f"sleeve{k}", SLEEVE_VERTICES, SLEEVE_TRIANGLES,
                           np.zeros((SLEEVE_VERTICES, 2)), _matt(mi, textures.TEXTURE_PX),
                           smooth=True),
        f"bands{k}": mesh(mi, f"bands{k}", n, repeated(BAND_TRIANGLES, BAND_VERTICES, MOST_BANDS),
                          np.zeros((n, 2)), bands, smooth=True),
    }  # fmt: skip


def _matt(mi: Any, size: int) -> dict[str, Any]:
    brdf = {"type": "diffuse", "reflectance": _bitmap(mi, (size, size), 3, "repeat")}
    return {"type": "twosided", "brdf": brdf}


def _glossy(mi: Any, size: tuple[int, int], wrap: str, *, metallic: bool = False) -> dict[str, Any]:
    filtering = "nearest" if metallic else "bilinear"
    brdf = {
        "type": "principled",
        "base_color": _bitmap(mi, size, 3, wrap, filtering),
        "roughness": _bitmap(mi, size, 1, wrap, filtering),
        "metallic": _bitmap(mi, size if metallic else (2, 2), 1, wrap, filtering, 0.0),
        "specular": 0.5,
    }
    return {"type": "twosided", "brdf": brdf}


def _bitmap(
    mi: Any, size: tuple[int, int], channels: int, wrap: str, filtering: str = "bilinear",
    value: float = 0.4,
) -> dict[str, Any]:  # fmt: skip
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.full((*size, channels), value, dtype=np.float32)),
        "filter_type": filtering,
        "wrap_mode": wrap,
        "raw": True,
    }
