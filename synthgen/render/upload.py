"""One persistent Mitsuba scene per structure, updated per sample so that nothing recompiles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.transforms import look_at
from synthgen.models import ManoModel
from synthgen.render import backend, materials, sky, textures
from synthgen.render.skin import material
from synthgen.render.solids import (
    Solid,
    hand_solid,
    place_solids,
    thing_solids,
    worn_solids,
)
from synthgen.scene import AreaLight, HandSubject, Lights, Scene
from synthgen.scene.relief import relief_of
from synthgen.scene.surface import DrawnSurface

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Structure:
    """What decides the compiled kernels: everything else of a sample is data.

    Attributes
    ----------
    hands : tuple of str
        Side of each subject.
    digests : tuple of str
        Model of each subject.
    n_lamps : int
    surround : {"constant", "sky", "none"}
    furnished : bool
        Whether there are meshes for things and for what is worn.
    quality : {"plain", "full"}
        Of the skin's material.
    picture_px : int
        Longer side of the picture, which decides the size of the skin's textures.
    """

    hands: tuple[str, ...]
    digests: tuple[str, ...]
    n_lamps: int
    surround: str
    furnished: bool
    quality: str
    picture_px: int

    @staticmethod
    def of(scene: Scene, models: tuple[ManoModel, ...], quality: str) -> Structure:
        """Return the structure that a scene needs."""
        dressed = any(s.sleeve is not None or s.bands for s in scene.subjects)
        lit, first = scene.lights, scene.cameras[0]
        dark = not any(lit.constant_rgb) and len(lit.area) > 0
        return Structure(
            hands=tuple(model.hand for model in models),
            digests=tuple(model.digest for model in models),
            n_lamps=len(lit.area),
            surround="sky" if lit.sky is not None else "none" if dark else "constant",
            furnished=quality == "full" or dressed or bool(scene.things),
            quality="full" if any(s.skin.detail for s in scene.subjects) else "plain",
            picture_px=max(first.width, first.height),
        )


@dataclass(frozen=True, eq=False)
class LiveSkin:
    """The material of one hand's skin; its maps are nearly all of a scene's memory.

    Attributes
    ----------
    bsdf : mitsuba.BSDF
    bump : mitsuba.Texture or None
        Its relief, in quality full.
    filled : dict
        Whose skin it holds.
    """

    bsdf: Any
    bump: Any
    filled: dict[str, Any]


class Skins:
    """Materials of skin by subject's number, quality and size: scenes of a process share them.

    One scene is drawn at a time, and fills the material with its own subject first.
    """

    def __init__(self) -> None:
        self._made: dict[tuple[int, str, int], LiveSkin] = {}

    def of(self, k: int, quality: str, size: int) -> LiveSkin:
        """Return the material of subject ``k``, empty when it is asked for first."""
        key = k, quality, size
        if key not in self._made:
            mi: Any = backend.mitsuba()
            described = material.describe(mi, quality, size)
            self._made[key] = LiveSkin(mi.load_dict(described), described.get("bump"), {})
        return self._made[key]


class LiveScene:
    """The uploaded scene of one structure.

    Parameters
    ----------
    models : tuple of ManoModel
        One per subject, in order.
    structure : Structure
    skins : Skins
        Shared with other scenes; whoever is updated last is drawn.
    """

    def __init__(self, models: tuple[ManoModel, ...], structure: Structure, skins: Skins) -> None:
        self.models = models
        self.structure = structure
        self.drawn = tuple(DrawnSurface.for_model(model) for model in models)
        self._look = (
            structure.quality, material.atlas_size(structure.quality, structure.picture_px)
        )  # fmt: skip
        self._skins = [skins.of(k, *self._look) for k in range(len(models))]
        self.bumps = {f"hand{k}": s.bump for k, s in enumerate(self._skins) if s.bump is not None}
        self._mi: Any = backend.mitsuba()
        self._scene = self._load()
        self._params = self._mi.traverse(self._scene)
        self.solids: list[Solid] = []
        self.lamps: list[Array] = []
        self._filled: dict[str, Any] = {}
        self._shapes = {shape.id(): shape for shape in self._scene.shapes()}

    @property
    def scene(self) -> Any:
        """The Mitsuba scene."""
        return self._scene

    @property
    def n_lamps(self) -> int:
        """Number of area lights."""
        return self.structure.n_lamps

    def shape(self, name: str) -> Any:
        """Return an uploaded shape by the name of its solid, or ``lamp0``..."""
        return self._shapes[name]

    def _load(self) -> Any:
        mi, structure = self._mi, self.structure
        description: dict[str, Any] = {"type": "scene"}
        if structure.surround == "constant":
            description["surround"] = {
                "type": "constant", "radiance": {"type": "rgb", "value": [0.5] * 3},
            }  # fmt: skip
        elif structure.surround == "sky":
            grey = np.full((sky.HEIGHT_PX, sky.WIDTH_PX, 3), 0.5, dtype=np.float32)
            description["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(grey)}
        for k, drawn in enumerate(self.drawn):
            skin = self._skins[k].bsdf
            description[f"hand{k}"] = materials.mesh(
                mi, f"hand{k}", len(drawn.uv), drawn.triangles, drawn.uv, skin, smooth=True
            )
        description |= materials.place_meshes(mi)
        if structure.furnished:
            description |= materials.thing_meshes(mi)
            for k in range(len(self.models)):
                description |= materials.worn_meshes(mi, k)
        for k in range(structure.n_lamps):
            description[f"lamp{k}"] = {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 3 + k, 0]),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
            }
        return mi.load_dict(description)

    def update(self, scene: Scene, surfaces: list[NDArray[np.float32]]) -> None:
        """Put a sample into the scene.

        Parameters
        ----------
        scene : Scene
        surfaces : list of (S, 3)
            Posed surface vertices per subject, world, metres.
        """
        self.solids = []
        for k, (subject, vertices) in enumerate(zip(scene.subjects, surfaces, strict=True)):
            model = self.models[k]
            relief = relief_of(model, subject.skin, np.array(subject.pose))
            self.solids.append(hand_solid(k, self.drawn[k], vertices, relief))
            self._colour_hand(k, subject)
        self.solids += place_solids(scene)
        self._colour_place(scene)
        if self.structure.furnished:
            for k, subject in enumerate(scene.subjects):
                self.solids += worn_solids(scene, k, self.models[k], subject)
                self._colour_worn(k, subject)
            self.solids += thing_solids(scene)
            self._colour_things(scene)
        for solid in self.solids:
            self._move(solid)
        self._put_lights(scene.lights)
        self._params.update()

    def move(self, scene: Scene, share: float) -> None:
        """Put subjects and what they wear at ``share`` (-1/2 .. 1/2) of the scene's motion."""
        assert scene.motion is not None
        for solid in self.solids:
            if solid.worn_by >= 0:
                self._move(solid.moved(scene.motion, share))
        self._params.update()

    def _move(self, solid: Solid) -> None:
        name = solid.name
        self._params[f"{name}.vertex_positions"] = backend.aligned(solid.vertices.ravel())
        if solid.normals is not None:
            self._params[f"{name}.vertex_normals"] = backend.aligned(solid.normals.ravel())
        if solid.uv is not None:
            self._params[f"{name}.vertex_texcoords"] = materials.flip_v(solid.uv)

    def _is_new(self, name: str, value: Any, filled: dict[str, Any] | None = None) -> bool:
        """Tell whether a texture must be filled again."""
        there = self._filled if filled is None else filled
        new = name not in there or there[name] != value
        there[name] = value
        return new

    def _colour_hand(self, k: int, subject: HandSubject) -> None:
        whose = self.models[k].digest, subject.hand, subject.skin
        if self._is_new("skin", whose, self._skins[k].filled):
            self._fill(f"hand{k}.bsdf", material.of_skin(self.models[k], subject.skin, *self._look))
        self._fill(f"hand{k}.bsdf", material.of_pose(self.models[k], subject, *self._look))

    def _colour_place(self, scene: Scene) -> None:
        back = scene.background
        if back.kind in ("empty", "outdoor") or not self._is_new("wall", back):
            pass
        elif back.kind == "photo":
            self._fill("wall.bsdf", {materials.DIFFUSE: textures.photo_texture(back)})
        else:
            self._fill("wall.bsdf", {materials.DIFFUSE: textures.wall_texture(back)})
        if back.kind in ("room", "outdoor") and self._is_new("floor", back):
            self._fill("floor.bsdf", {materials.DIFFUSE: textures.floor_texture(back)})

    def _colour_worn(self, k: int, subject: HandSubject) -> None:
        if subject.sleeve is not None and self._is_new(f"sleeve{k}", subject.sleeve):
            cloth = textures.sleeve_texture(subject.sleeve)
            self._fill(f"sleeve{k}.bsdf", {materials.DIFFUSE: cloth})
        if subject.bands and self._is_new(f"bands{k}", subject.bands):
            values = zip(materials.GLOSSY, textures.bands_atlas(subject.bands), strict=True)
            self._fill(f"bands{k}.bsdf", dict(values))

    def _colour_things(self, scene: Scene) -> None:
        tables = [t for t in scene.things if t.role == "support"]
        if tables and self._is_new("table", tables[0]):
            rough = np.full((2, 2, 1), tables[0].roughness, dtype=np.float32)
            top = textures.table_texture(tables[0])
            self._fill("table.bsdf", dict(zip(materials.GLOSSY, (top, rough), strict=False)))
        if scene.things and self._is_new("things", scene.things):
            both = textures.things_atlas(scene.things)
            for name in ("boxes", "turned"):
                self._fill(f"{name}.bsdf", dict(zip(materials.GLOSSY, both, strict=False)))

    def _put_lights(self, lights: Lights) -> None:
        if self.structure.surround == "constant":
            self._params["surround.radiance.value"] = self._colour(lights.constant_rgb)
        if lights.sky is not None and self._is_new("sky", lights.sky):
            radiance = sky.padded(sky.radiance_of(lights.sky))
            self._params["sky.data"] = self._mi.TensorXf(backend.aligned(radiance))
        self.lamps = []
        for k, lamp in enumerate(lights.area):
            self._put_lamp(k, lamp)

    def _put_lamp(self, k: int, lamp: AreaLight) -> None:
        position, target = np.array(lamp.position_m), np.array(lamp.target_m)
        axis = (target - position) / np.linalg.norm(target - position)
        up = (0.0, 1.0, 0.0) if abs(axis[1]) < 0.99 else (1.0, 0.0, 0.0)
        frame = look_at(position, target, up)
        self.lamps.append(frame)
        matrix = frame @ np.diag([lamp.size_m / 2] * 2 + [1.0, 1.0])
        transform = self._mi.Transform4f(matrix.astype(np.float32))
        backend.drjit().make_opaque(transform)
        self._params[f"lamp{k}.to_world"] = transform
        self._params[f"lamp{k}.emitter.radiance.value"] = self._colour(lamp.radiance_rgb)

    def _fill(self, prefix: str, values: material.Values) -> None:
        """Fill a material's textures and numbers by name.

        At once, one material after the other: what waits is computed together, by another kernel
        for every set of textures that happens to change with the same sample.
        """
        for key, value in values.items():
            self._params[f"{prefix}.{key}"] = (
                self._number(value)
                if isinstance(value, float)
                else self._mi.TensorXf(backend.aligned(value))
            )
        self._params.update()
        backend.drjit().eval()

    def _number(self, value: Any) -> Any:
        """Pass a number as data: a literal would be compiled into the kernels."""
        return backend.drjit().opaque(self._mi.Float, float(value))

    def _colour(self, rgb: tuple[float, float, float]) -> Any:
        return self._mi.Color3f(*(self._number(value) for value in rgb))
