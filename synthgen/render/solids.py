"""The meshes of a scene by name, as they are drawn and as they are labelled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.transforms import turn_about
from synthgen.models import ManoModel
from synthgen.render import background, textures
from synthgen.sampling.things import MOST_BOXES, MOST_TURNED
from synthgen.scene import HandSubject, Motion, Scene
from synthgen.scene.instances import objects_of
from synthgen.scene.solids import (
    BOX_TRIANGLES,
    BOX_VERTICES,
    TURNED_TRIANGLES,
    TURNED_VERTICES,
    SolidMesh,
    mesh_of,
)
from synthgen.scene.surface import DrawnSurface
from synthgen.scene.wear import (
    BAND_TRIANGLES,
    BAND_VERTICES,
    SLEEVE_TRIANGLES,
    SLEEVE_VERTICES,
    dress,
)

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

MOST_BANDS = 3
# Unused slots wait here, under every floor.
NOWHERE_M = np.array([0.0, -60.0, 0.0])


@dataclass(frozen=True, eq=False)
class Solid:
    """A triangle mesh as it stands in the scene: float32 values, kept in float64.

    Attributes
    ----------
    name : str
    vertices : (V, 3), triangles : (F, 3)
    normals : (V, 3) or None
        Unit vertex normals; None for flat faces.
    uv : (V, 2) or None
        Where it changes from sample to sample; origin bottom left.
    instance, part : (F,) int64 or None
        Labels of its triangles; None for hands, which have finer ones, and for the background.
    worn_by : int
        Subject that it moves with, or -1.
    """

    name: str
    vertices: Array
    triangles: Ids
    normals: Array | None
    uv: Array | None = None
    instance: Ids | None = None
    part: Ids | None = None
    worn_by: int = -1

    def moved(self, motion: Motion, share: float) -> Solid:
        """Return it at ``share`` (-1/2 .. 1/2) of a motion."""
        rotation, shift = turn_about(
            np.array(motion.centre_m), share * np.array(motion.turn),
            share * np.array(motion.shift_m),
        )  # fmt: skip
        normals = None if self.normals is None else _single(self.normals @ rotation.T)
        return replace(self, vertices=_single(self.vertices @ rotation.T + shift), normals=normals)


def _single(values: Array) -> Array:
    """Round to float32, as the renderer has it, so that labels meet what is drawn."""
    return values.astype(np.float32).astype(np.float64)


def hand_solid(
    k: int, drawn: DrawnSurface, surface: NDArray[np.float32], relief: Array | None
) -> Solid:
    """Return the mesh of subject ``k``."""
    vertices, normals = drawn.draw(surface, relief)
    return Solid(
        f"hand{k}", vertices.astype(float), drawn.triangles.astype(np.int64),
        normals.astype(float), worn_by=k,
    )  # fmt: skip


def place_solids(scene: Scene) -> list[Solid]:
    """Return wall and floor; either may be nowhere."""
    wall, wall_uv = background.wall_geometry(scene.background, scene.cameras[0])
    floor, floor_uv = background.floor_geometry(scene.background)
    return [
        Solid("wall", _single(wall), background.quads(background.WALLS), None, wall_uv),
        Solid("floor", _single(floor), background.quads(1), None, floor_uv),
    ]


def thing_solids(scene: Scene) -> list[Solid]:
    """Return the table, all boxes and all turned bodies, each kind as one mesh of slots."""
    ids = {o.place: (o.instance_id, o.part_id) for o in objects_of(scene) if o.subject < 0}
    tables: list[tuple[SolidMesh, tuple[int, int]]] = []
    boxes: list[tuple[SolidMesh, tuple[int, int]]] = []
    turned: list[tuple[SolidMesh, tuple[int, int]]] = []
    for number, thing in enumerate(scene.things):
        into = tables if thing.role == "support" and thing.shape == "box" else (
            boxes if thing.shape == "box" else turned)  # fmt: skip
        into.append((mesh_of(thing), ids.get(number, (0, 0))))
    return [
        _slots("table", tables, 1, BOX_VERTICES, BOX_TRIANGLES, None),
        _slots("boxes", boxes, MOST_BOXES, BOX_VERTICES, BOX_TRIANGLES, textures.atlas_uv),
        _slots("turned", turned, MOST_TURNED, TURNED_VERTICES, TURNED_TRIANGLES,
               lambda uv, k: textures.atlas_uv(uv, MOST_BOXES + k)),
    ]  # fmt: skip


def worn_solids(scene: Scene, k: int, model: ManoModel, subject: HandSubject) -> list[Solid]:
    """Return the sleeve and the bands of subject ``k``; either may be nowhere."""
    worn = dress(model, subject)
    ids = [o for o in objects_of(scene) if o.subject == k]
    sleeves = [(worn.sleeve, (o.instance_id, o.part_id)) for o in ids
               if o.place < 0 and worn.sleeve is not None]  # fmt: skip
    bands = [(worn.bands[o.place], (o.instance_id, o.part_id)) for o in ids if o.place >= 0]
    return [
        _slots(f"sleeve{k}", sleeves, 1, SLEEVE_VERTICES, SLEEVE_TRIANGLES, None, k),
        _slots(f"bands{k}", bands, MOST_BANDS, BAND_VERTICES, BAND_TRIANGLES,
               textures.band_uv, k),
    ]  # fmt: skip


def _slots(
    name: str, meshes: list[tuple[SolidMesh, tuple[int, int]]], most: int, n_vertices: int,
    triangles: Ids, place_uv: Callable[[Array, int], Array] | None, worn_by: int = -1,
) -> Solid:  # fmt: skip
    """Lay meshes of one topology behind one another; slots left over are nowhere."""
    vertices = np.tile(NOWHERE_M, (most * n_vertices, 1))
    normals = np.tile([0.0, 1.0, 0.0], (most * n_vertices, 1))
    uv = np.zeros((most * n_vertices, 2))
    instance, part = np.zeros((2, most * len(triangles)), dtype=np.int64)
    for k, (mesh, ids) in enumerate(meshes[:most]):
        own = slice(k * n_vertices, (k + 1) * n_vertices)
        vertices[own], normals[own] = mesh.vertices, mesh.normals
        uv[own] = mesh.uv if place_uv is None else place_uv(mesh.uv, k)
        faces = slice(k * len(triangles), (k + 1) * len(triangles))
        instance[faces], part[faces] = ids
    return Solid(
        name=name,
        vertices=_single(vertices),
        triangles=repeated(triangles, n_vertices, most),
        normals=_single(normals),
        uv=uv,
        instance=instance,
        part=part,
        worn_by=worn_by,
    )


def repeated(triangles: Ids, n_vertices: int, count: int) -> Ids:
    """Return the triangles of ``count`` copies of a mesh."""
    steps = n_vertices * np.arange(count)[:, None, None]
    return np.asarray((triangles + steps).reshape(-1, 3))
