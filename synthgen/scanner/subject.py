"""What stands before a scanner: solids with their skin, and how they move."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.transforms import apply

Array = NDArray[np.float64]
SolidKind = Literal["subject", "object", "stand"]


@dataclass(frozen=True)
class Surface:
    """Optics of a solid's surface.

    Attributes
    ----------
    albedo : float
        Grey reflectance in the speckle pictures, 0..1.
    rgb : tuple of float
        Linear sRGB reflectance in the colour pictures (used where there are no vertex colours).
    specular, roughness : float
        Weight of a GGX lobe with Fresnel reflectance 0.04 (skin is near 0.028), and its roughness,
        the square of which is GGX's alpha (0.3 for skin: d'Eon and Luebke, GPU Gems 3, ch. 14);
        weight 0 is a Lambertian surface.
    subsurface : float
        Share of the irradiance that is spread below the surface, 0..1.
    subsurface_m : float
        Sigma of that spread along the surface, per axis.
    """

    albedo: float = 0.5
    rgb: tuple[float, float, float] = (0.62, 0.38, 0.28)
    specular: float = 0.7
    roughness: float = 0.55
    subsurface: float = 0.6
    subsurface_m: float = 0.001


SKIN = Surface()
GREEN = Surface(0.25, (0.05, 0.45, 0.10), 0.5, 0.4, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Solid:
    """A triangle mesh with its surface.

    Attributes
    ----------
    vertices : (V, 3) float64
        Rig frame, metres, at time 0 (the middle of the reference exposure).
    faces : (F, 3) int64
    normals : (V, 3) float64 or None
        Unit vertex normals that shading interpolates; None shades flat faces.
    surface : Surface
    kind : {"subject", "object", "stand"}
        What segmentation should make of it.
    velocity_m_s : (V, 3) or (3,) float64 or None
        Of the vertices, or of the whole solid; None stands still.
    colours : (V, 3) float64 or None
        Linear reflectance per vertex for the colour pictures, instead of ``surface.rgb``.
    """

    vertices: Array
    faces: NDArray[np.int64]
    normals: Array | None
    surface: Surface = SKIN
    kind: SolidKind = "subject"
    velocity_m_s: Array | None = None
    colours: Array | None = None

    def at(self, time_s: float) -> Array:
        """Return the vertices (V, 3) at a time, metres."""
        if self.velocity_m_s is None:
            return self.vertices
        return self.vertices + self.velocity_m_s * time_s


@dataclass(frozen=True, eq=False)
class ScanScene:
    """Solids before a scanner, in the rig's frame."""

    solids: tuple[Solid, ...]


def solid_from_mesh(mesh: Any, surface: Surface = SKIN, *, smooth: bool = True,
                    **rest: Any) -> Solid:  # fmt: skip
    """Make a solid of anything with ``vertices`` and ``faces`` (trimesh.Trimesh), metres.

    Raises
    ------
    ShapeError
        If the mesh is empty, not triangles, not finite, or its faces name missing vertices.
    """
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
    _check_mesh("the mesh", vertices, faces)
    return Solid(vertices, faces, vertex_normals(vertices, faces) if smooth else None,
                 surface, **rest)  # fmt: skip


def _check_mesh(what: str, vertices: Array, faces: NDArray[np.int64]) -> None:
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        raise ShapeError(
            f"a scan needs vertices (V, 3) and triangles (F, 3); {what} has {vertices.shape} and "
            f"{faces.shape}; triangulate the mesh"
        )
    if not len(faces):
        raise ShapeError(f"{what} has no faces; there is nothing to scan")
    wrong = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(wrong):
        raise ShapeError(
            f"{what}: vertex {wrong[0]} is {vertices[wrong[0]].tolist()}; give finite metres"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ShapeError(
            f"{what}: faces name vertices {faces.min()}..{faces.max()}; there are {len(vertices)}"
        )


def _check_surface(what: str, surface: Surface) -> None:
    shares = {"albedo": (surface.albedo,), "rgb": surface.rgb, "specular": (surface.specular,),
              "roughness": (surface.roughness,), "subsurface": (surface.subsurface,)}  # fmt: skip
    for name, values in shares.items():
        if not all(0.0 <= value <= 1.0 for value in values):
            raise ShapeError(
                f"{what}: surface.{name} = {getattr(surface, name)}; 0 to 1 is possible"
            )
    if not 0.0 <= surface.subsurface_m < np.inf:
        raise ShapeError(
            f"{what}: surface.subsurface_m = {surface.subsurface_m}; give metres, 0 or more"
        )


def scene_of(mesh_or_scene: Any) -> ScanScene:
    """Return a scene: as it is, or one solid with the default skin made of a mesh.

    Raises
    ------
    ShapeError
        If a solid is empty, not triangles or not finite, its faces name missing vertices, or its
        surface has a value out of range; the message names it.
    """
    if isinstance(mesh_or_scene, ScanScene):
        for k, solid in enumerate(mesh_or_scene.solids):
            _check_mesh(f"solid {k}", solid.vertices, solid.faces)
            _check_surface(f"solid {k}", solid.surface)
        return mesh_or_scene
    if hasattr(mesh_or_scene, "vertices") and hasattr(mesh_or_scene, "faces"):
        return ScanScene((solid_from_mesh(mesh_or_scene),))
    raise ShapeError(
        f"cannot scan a {type(mesh_or_scene).__name__}: give a trimesh.Trimesh in metres or a "
        "synthgen.scanner.ScanScene"
    )


def placed(scene: ScanScene, T: NDArray[Any]) -> ScanScene:
    """Return the scene after a rigid ``T_dst_from_src`` (4, 4), velocities included."""
    turn = T[:3, :3].T
    return ScanScene(
        tuple(
            replace(
                solid,
                vertices=apply(T, solid.vertices),
                normals=None if solid.normals is None else solid.normals @ turn,
                velocity_m_s=None if solid.velocity_m_s is None else solid.velocity_m_s @ turn,
            )
            for solid in scene.solids
        )
    )


def moved(scene: ScanScene, velocity_m_s: tuple[float, float, float]) -> ScanScene:
    """Return the scene in which every solid moves with one velocity, metres per second."""
    velocity = np.asarray(velocity_m_s, dtype=np.float64)
    return ScanScene(tuple(replace(s, velocity_m_s=velocity) for s in scene.solids))
