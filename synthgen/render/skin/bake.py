"""Bake what a topology's skin needs once, into its atlas, and keep it in the user's cache."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import os
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry import nearest, raster
from synthgen.models import ManoModel, mirror_model
from synthgen.render.skin import creases, fields, nails, noise, sites
from synthgen.render.skin.cache import cache_folder
from synthgen.sampling import streams
from synthgen.scene import anatomy as anatomy_module
from synthgen.scene import relief, surface, veins
from synthgen.scene.anatomy import Anatomy, anatomy_of
from synthgen.scene.surface import DrawnSurface

Values = NDArray[np.float32]

# What decides a bake besides the model: a change of any of these makes new maps.
_SOURCES: tuple[ModuleType, ...] = (
    anatomy_module, relief, surface, veins, creases, fields, nails, noise, sites, nearest, raster,
    streams, sys.modules[__name__],
)  # fmt: skip
_LIBRARIES = ("numpy", "scipy", "numba")
_WHOLE = {"joint": np.uint8, "freckle": np.uint16}


@dataclass(frozen=True, eq=False)
class SkinMaps:
    """Fields over the covered texels (n,) of one topology's atlas, the same for every person.

    Fields as in :class:`~synthgen.render.skin.fields.Zones`,
    :class:`~synthgen.render.skin.fields.Grain`, :class:`~synthgen.render.skin.nails.Nails` and
    :class:`~synthgen.render.skin.creases.Creases`; heights in millimetres. ``fill`` (size, size)
    names the covered texel shown at each texel.
    """

    fill: NDArray[np.int32]
    palm: Values
    inner: Values
    knuckle: Values
    tip: Values
    pad: Values
    vein: Values
    big: Values
    middle: Values
    fine: Values
    pigment: Values
    cell: Values
    freckle: NDArray[np.uint16]
    freckle_mm: Values
    plate: Values
    nail_along: Values
    nail_across: Values
    cuticle: Values
    tint: Values
    still: Values
    wrinkles: Values
    folds: Values
    lines: Values
    joint: NDArray[np.uint8]

    @property
    def size(self) -> int:
        """Edge of the atlas, texels."""
        return len(self.fill)


def bake(model: ManoModel, size: int) -> SkinMaps:
    """Return the maps of a model's topology, from the cache where it has them.

    Parameters
    ----------
    model : ManoModel
        Left hands share the maps of the right hands that they mirror.
    size : int
        Edge of the atlas, texels: 1024 suits pictures up to about 320 px.
    """
    return _cached(_right(model), size)


@lru_cache(maxsize=8)
def _right(model: ManoModel) -> ManoModel:
    return model if model.hand == "right" else mirror_model(model)


@lru_cache(maxsize=4)
def _cached(model: ManoModel, size: int) -> SkinMaps:
    file = cache_folder("skin") / f"{_key(model, size)}.npz"
    found = _read(file)
    if found is None:
        found = bake_maps(model, size)
        _write(file, found)
    return found


def bake_maps(model: ManoModel, size: int) -> SkinMaps:
    """Lay out the maps of a right hand anew."""
    anatomy = anatomy_of(model)
    texels, fill = sites.atlas_sites(model, size)
    return _rounded(_lay(texels, anatomy), fill)


def _lay(texels: sites.Sites, anatomy: Anatomy) -> dict[str, NDArray[np.generic]]:
    zones = fields.lay_zones(texels, anatomy)
    plates = nails.lay_nails(texels, anatomy)
    grain = fields.lay_grain(texels, zones.palm, plates.plate)
    folded = creases.lay_creases(texels, anatomy)
    bare = 1 - plates.plate
    values = {f.name: getattr(zones, f.name) for f in dataclasses.fields(zones)}
    values |= {f.name: getattr(grain, f.name) for f in dataclasses.fields(grain)}
    del values["relief"]
    values |= {"plate": plates.plate, "cuticle": plates.cuticle}
    values |= {"nail_along": plates.along, "nail_across": plates.across}
    values |= {"tint": folded.tint * bare, "still": grain.relief + plates.height}
    values |= {
        "wrinkles": folded.wrinkles * bare, "folds": folded.folds * bare, "lines": folded.lines
    }  # fmt: skip
    return {**values, "joint": folded.joint}


def _rounded(values: dict[str, NDArray[np.generic]], fill: NDArray[np.int32]) -> SkinMaps:
    """Keep half precision, so that fresh maps equal those read back."""
    stored = {name: v.astype(_WHOLE.get(name, np.float16)) for name, v in values.items()}
    return _widened({**stored, "fill": fill})


def _widened(stored: dict[str, NDArray[np.generic]]) -> SkinMaps:
    return SkinMaps(**{
        name: value.astype(np.float32) if value.dtype == np.float16 else value
        for name, value in stored.items()
    })  # type: ignore[arg-type]  # fmt: skip


def _key(model: ManoModel, size: int) -> str:
    total = hashlib.sha256(f"{size}".encode())
    for module in _SOURCES:
        total.update(inspect.getsource(module).encode())
    for library in _LIBRARIES:  # they decide last bits, and a corpus records them
        total.update(metadata.version(library).encode())
    drawn, anatomy = DrawnSurface.for_model(model), anatomy_of(model)
    for array in (anatomy.points, anatomy.weights, anatomy.nail):
        total.update(np.round(array, 7).tobytes())
    total.update(drawn.uv.tobytes() + np.sort(drawn.triangles, axis=1).tobytes())
    return total.hexdigest()[:32]


def _read(file: Path) -> SkinMaps | None:
    """Return stored maps; None where there are none, or not whole ones."""
    wanted = {f.name for f in dataclasses.fields(SkinMaps)}
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as content:
            if set(content.files) != wanted:
                return None
            return _widened({name: content[name] for name in content.files})
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None


def _write(file: Path, maps: SkinMaps) -> None:
    """Store maps whole or not at all; a folder that cannot be written to costs only time."""
    stored = {
        f.name: getattr(maps, f.name) for f in dataclasses.fields(maps)
    }  # fmt: skip
    stored = {k: v.astype(np.float16) if v.dtype == np.float32 else v for k, v in stored.items()}
    temporary = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as part:
            temporary = Path(part.name)
            np.savez(part, **stored)
        os.replace(temporary, file)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
