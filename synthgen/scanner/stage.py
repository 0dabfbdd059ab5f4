"""A scene put before a scanner: uploaded once, with the light that is kept at its vertices.

What is kept at vertices: which projectors reach them (so that most points need no shadow ray),
the light that spreads below the skin, and the light that other parts of the scene throw.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.normals import face_cross, unit, vertex_normals
from synthgen.render import backend
from synthgen.scanner import light
from synthgen.scanner.diffusion import Diffusion, heat_flow
from synthgen.scanner.mesh import DrawnMesh, drawn_mesh, typical_edge
from synthgen.scanner.placement import check_placement
from synthgen.scanner.rig import Rig
from synthgen.scanner.subject import ScanScene, scene_of

Array = NDArray[np.float64]

# Light at vertices stands for the faces between them where these are at most this many pixels.
_FINE_PX = 3.0
# Blur below the skin needs vertices at least this dense, in sigmas.
_SKIN_FINE = 0.6


@dataclass(frozen=True)
class Effects:
    """Switches of what makes light; all on is the default.

    Attributes
    ----------
    shadows, specular, subsurface, defocus : bool
    bounce : bool
        Light between parts of the scene, one bounce.
    vertex_cache : bool
        Shadow rays only where the corners of a face disagree; False casts them all.
    """

    shadows: bool = True
    specular: bool = True
    subsurface: bool = True
    defocus: bool = True
    bounce: bool = True
    vertex_cache: bool = True


ALL = Effects()


class Stage:
    """The uploaded scene; changes only by :meth:`pose`.

    Attributes
    ----------
    rig : Rig
    key : int
        Of every random stream of this scan.
    effects : Effects
    mesh : DrawnMesh
    kept : dict
        Light at the vertices by slot, as last made.
    velocity_m_s : (3,) float64
        By which all solids move as one; the scene is then never posed again.
    rigid : bool
        All solids move as one or stand still.
    vertices, normals : (V, 3) float64
        As they stand now.
    coarse : Bool
        Faces too long for light at their corners to stand for them.
    gsd_m : float
        Smallest size of a pixel at the origin.
    notes : list of str
        What could not be done as asked.
    """

    def __init__(self, scene: ScanScene, rig: Rig, key: int, effects: Effects = ALL):
        self.rig, self.key, self.effects = rig, key, effects
        self.kept: dict[Any, Any] = {}
        self.notes: list[str] = []
        self.gsd_m = min(_gsd(unit_.nominal.left) for unit_ in rig.units)
        self.fine_m = _FINE_PX * self.gsd_m
        self.mesh: DrawnMesh = drawn_mesh(scene, _wanted_edge(scene, rig, effects, self.gsd_m))
        self.rigid, self.velocity_m_s = _common_velocity(scene)
        self._mi: Any = backend.mitsuba()
        self._upload()
        self.posed_s = 0.0

    @cached_property
    def table(self) -> light.ProjectorTable:
        """The projectors, uploaded when light is first asked for."""
        return light.upload(self.rig if self.effects.defocus else _sharp(self.rig))

    @cached_property
    def skins(self) -> list[Diffusion | None]:
        """Heat flow below the skin per solid, prepared when light is first asked for."""
        return self._prepare_skin()

    def _upload(self) -> None:
        mi, mesh = self._mi, self.mesh
        shape = mi.Mesh("scene", len(mesh.vertices), len(mesh.faces))
        params = mi.traverse(shape)
        params["faces"] = mi.UInt32(mesh.faces.astype(np.uint32).ravel())
        params["vertex_positions"] = mi.Float(mesh.vertices.astype(np.float32).ravel())
        params.update()
        self.scene = mi.load_dict({"type": "scene", "mesh": shape})
        self._params = mi.traverse(self.scene)
        corners = np.column_stack([mesh.faces, mesh.solid_of_face]).astype(np.uint32)
        self.corners = mi.UInt32(corners.ravel())
        surfaces = [part.solid.surface for part in mesh.parts]
        on = self.effects
        rows = [
            [
                s.albedo,
                s.subsurface if on.subsurface else 0.0,
                s.specular if on.specular else 0.0,
                max(s.roughness, 0.05) ** 2,
            ]
            for s in surfaces
        ]
        self.surfaces = mi.Float(np.array(rows, dtype=np.float32).ravel())
        self._put_normals(mesh.vertices, mesh.normals)

    def _put_normals(self, vertices: Array, normals: Array) -> None:
        mi, n = self._mi, len(self.mesh.faces)
        flat = np.zeros((n, 4), dtype=np.float32)
        flat[:, :3] = unit(face_cross(vertices, self.mesh.faces))
        self.face_normals = mi.Float(flat.ravel())
        self.vertices, self.normals = vertices, normals
        longest = np.max([_side(vertices, self.mesh.faces, k) for k in range(3)], axis=0)
        self.coarse = mi.Bool(longest > 2 * self.fine_m)

    def _prepare_skin(self) -> list[Diffusion | None]:
        found: list[Diffusion | None] = []
        for k, part in enumerate(self.mesh.parts):
            surface = part.solid.surface
            sigma, problem = surface.subsurface_m, None
            if not self.effects.subsurface or surface.subsurface == 0:
                found.append(None)
                continue
            edge = typical_edge(part.points, part.faces)
            if sigma <= self.gsd_m:
                problem = f"it would be finer than a pixel ({1e3 * self.gsd_m:.2f} mm)"
            elif edge > sigma / _SKIN_FINE:
                problem = f"the triangles ({1e3 * edge:.2f} mm) are too coarse for it"
            if problem is not None:
                self.notes.append(
                    f"solid {k}: no blur of {1e3 * sigma:.2f} mm below the skin: {problem}"
                )
                self._switch_off_skin(k)
            flow = heat_flow(part.points, part.faces, sigma) if problem is None else None
            found.append(flow)
        return found

    def _switch_off_skin(self, solid: int) -> None:
        values = np.array(self.surfaces)
        values[4 * solid + 1] = 0.0
        self.surfaces = self._mi.Float(values)

    def pose(self, time_s: float) -> None:
        """Move the solids to a time, where they do not move as one; rebuilds the BVH."""
        if self.rigid or time_s == self.posed_s:
            return
        vertices = self.mesh.at(time_s)
        self._params["mesh.vertex_positions"] = self._mi.Float(vertices.astype(np.float32).ravel())
        self._params.update()
        self.posed_s = time_s
        self._put_normals(vertices, _turned(self.mesh, time_s))

    def shift(self, time_s: float) -> Array:
        """Return how far the whole scene has moved from its pose at a time, (3,)."""
        return self.velocity_m_s * (time_s - self.posed_s)


def prepare(
    mesh_or_scene: Any, rig: Rig, *, rng: np.random.Generator, effects: Effects = ALL
) -> Stage:
    """Put a scene before a scanner.

    Parameters
    ----------
    mesh_or_scene : trimesh.Trimesh or ScanScene
        Metres, in the rig's frame.
    rig : Rig
    rng : numpy.random.Generator
        One number is drawn: the key of every stream of this scan.
    effects : Effects

    Raises
    ------
    ScanError
        If the subject is outside the working volume, or a camera or projector inside a solid.
    ShapeError
        If ``rng`` is no generator.
    """
    if not isinstance(rng, np.random.Generator):
        raise ShapeError(f"rng = {rng!r}; give a generator: numpy.random.default_rng(0)")
    backend.activate()
    scene = scene_of(mesh_or_scene)
    check_placement(scene, rig)
    return Stage(scene, rig, int(rng.integers(2**62)), effects)


def _gsd(camera: Any) -> float:
    return float(np.linalg.norm(camera.position) / camera.fx)


def _wanted_edge(scene: ScanScene, rig: Rig, effects: Effects, gsd: float) -> float:
    """Return the edge of triangles that keep light well: pixels, blobs and skin say how fine."""
    dot = min(p.pattern.dot_px * p.focus_m / p.optics.fx for p in rig.projectors)
    sigmas = [s.surface.subsurface_m for s in scene.solids if s.surface.subsurface > 0]
    seen = [sigma for sigma in sigmas if sigma > gsd and effects.subsurface]
    return min(_FINE_PX * gsd, *(min(_SKIN_FINE * sigma, 0.75 * dot) for sigma in seen), np.inf)


def _common_velocity(scene: ScanScene) -> tuple[bool, Array]:
    """Return whether everything moves as one, and how."""
    means = []
    for solid in scene.solids:
        velocity = np.zeros(3) if solid.velocity_m_s is None else np.asarray(solid.velocity_m_s)
        flat = velocity.reshape(-1, 3)
        if np.ptp(flat, axis=0).max() > 1e-12:
            return False, np.zeros(3)
        means.append(flat[0])
    same = bool(np.ptp(np.array(means), axis=0).max() <= 1e-12)
    return same, means[0] if same else np.zeros(3)


def _sharp(rig: Rig) -> Rig:
    return replace(rig, projectors=tuple(replace(p, aperture_m=0.0) for p in rig.projectors))


def _side(vertices: Array, faces: NDArray[np.int64], k: int) -> Array:
    """Return the lengths (F,) of the sides that start at corner k."""
    side = vertices[faces[:, k]] - vertices[faces[:, (k + 1) % 3]]
    return np.asarray(np.sqrt(np.einsum("fk,fk->f", side, side)))


def _turned(mesh: DrawnMesh, time_s: float) -> Array:
    """Return the drawn vertices' normals at a time."""
    rows = []
    for part in mesh.parts:
        own = part.solid.at(time_s)
        if part.solid.normals is None:
            flat = unit(face_cross(part.spread(own), part.faces))
            rows.append(np.repeat(flat, 3, axis=0))
        else:
            rows.append(unit(part.spread(vertex_normals(own, part.solid.faces))))
    return np.concatenate(rows)
