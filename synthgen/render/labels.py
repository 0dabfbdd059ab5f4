"""Labels from one ray through each pixel centre, never from a filtered film.

Mitsuba finds which triangle a ray meets; where it meets it is then computed in float64 from the
triangle's own plane, so that depth is exact to 1e-5 m whatever the near clip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, pixel_rays
from synthgen.geometry.hits import meet
from synthgen.render import backend
from synthgen.render.upload import LiveScene

Array = NDArray[np.float64]
NOTHING, LAMP = -1, 1000


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits of n rays.

    Attributes
    ----------
    solid : (n,) int32
        Index into the scene's solids (hands come first); 1000 + k for lamp k; -1 none.
    prim : (n,) int64
        Drawn triangle, 0 for lamps.
    barycentric : (n, 3) float64
        Weights of the triangle's corners.
    distance_m : (n,) float64
        Along the unit ray, from its origin; 0 where nothing is hit.
    normal : (n, 3) float64
        Unit, world, towards the origin; smooth where the mesh is.
    """

    solid: NDArray[np.int32]
    prim: NDArray[np.int64]
    barycentric: Array
    distance_m: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class Labels:
    """Per-pixel labels of one view, (H, W, ...).

    Attributes
    ----------
    depth_z_m, distance_m : float32
        Metres along the optical axis, and from the camera's centre; background included, 0 where
        nothing is hit.
    normals : (H, W, 3) float32
        Camera frame, unit, towards the camera.
    uv : (H, W, 2) float32
        Texture coordinates on hands, origin bottom left.
    part_id, instance_id : uint8
        Part: 0 none, 1-16 the hand's joints, 17 forearm, 18 sleeve, 19 object. Instance: 0
        background, then subjects, then what they wear and what is before them
        (:func:`synthgen.scene.instances.objects_of`).
    face_id : int32
        Face of the model's surface, -1 off hands; ``barycentric`` (H, W, 3) float32 within it.
    valid : bool
        Something was hit.
    """

    depth_z_m: NDArray[np.float32]
    distance_m: NDArray[np.float32]
    normals: NDArray[np.float32]
    uv: NDArray[np.float32]
    part_id: NDArray[np.uint8]
    instance_id: NDArray[np.uint8]
    face_id: NDArray[np.int32]
    barycentric: NDArray[np.float32]
    valid: NDArray[np.bool_]


def trace(live: LiveScene, origin: Array, directions: Array) -> Hits:
    """Shoot rays from one origin (3,) along unit directions (n, 3), world."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    o = mi.Point3f(*(dr.opaque(mi.Float, float(v)) for v in origin))
    d = mi.Vector3f(*(mi.Float(backend.aligned(c)) for c in directions.T))
    found = live.scene.ray_intersect_preliminary(mi.Ray3f(o, d))
    dr.eval(found)  # one trace; every conversion below would repeat it otherwise
    registered = np.array(dr.reinterpret_array(mi.UInt32, found.shape))
    solid = np.full(len(directions), NOTHING, dtype=np.int32)
    names = {mesh.name: k for k, mesh in enumerate(live.solids)}
    names |= {f"lamp{k}": LAMP + k for k in range(live.n_lamps)}
    for name, number in names.items():
        pointer = mi.ShapePtr(live.shape(name))
        own = np.array(dr.reinterpret_array(mi.UInt32, pointer))[0]
        solid[registered == own] = number
    solid[~np.array(found.is_valid())] = NOTHING
    prim = np.array(found.prim_index).astype(np.int64)
    return _refined(live, solid, prim, origin, directions)


def _refined(
    live: LiveScene, solid: NDArray[np.int32], prim: NDArray[np.int64], origin: Array, rays: Array
) -> Hits:
    n = len(solid)
    barycentric, distance, normal = np.zeros((n, 3)), np.zeros(n), np.zeros((n, 3))
    out = barycentric, distance, normal
    for k, mesh in enumerate(live.solids):
        own = np.flatnonzero(solid == k)
        meet(mesh.vertices, mesh.triangles, mesh.normals, own, prim, origin, rays, out)
    for k, frame in enumerate(live.lamps):
        own = np.flatnonzero(solid == LAMP + k)
        axis = frame[:3, 2]
        along = rays[own] @ axis
        distance[own] = (frame[:3, 3] - origin) @ axis / along
        normal[own] = -np.sign(along)[:, None] * axis
    prim[(solid < 0) | (solid >= LAMP)] = 0
    return Hits(solid, prim, barycentric, distance, normal)


def label_view(live: LiveScene, camera: Camera) -> Labels:
    """Label every pixel of one view of the uploaded scene."""
    origin, directions = pixel_rays(camera)
    shape = directions.shape[:2]
    rays = directions.reshape(-1, 3)
    hits = trace(live, origin, rays)
    rotation = camera.T[:3, :3]
    n = len(rays)
    face, inside = np.full(n, -1, dtype=np.int32), np.zeros((n, 3))
    part, uv = np.zeros(n, dtype=np.uint8), np.zeros((n, 2), dtype=np.float32)
    instance = np.zeros(n, dtype=np.uint8)
    for k, drawn in enumerate(live.drawn):
        own = np.flatnonzero(hits.solid == k)
        face[own], inside[own] = drawn.parent(hits.prim[own], hits.barycentric[own])
        part[own] = drawn.part(face[own], inside[own])
        uv[own] = drawn.texture(face[own], inside[own])
        instance[own] = k + 1
    for k, mesh in enumerate(live.solids):
        if mesh.instance is not None and mesh.part is not None:
            own = np.flatnonzero(hits.solid == k)
            instance[own], part[own] = mesh.instance[hits.prim[own]], mesh.part[hits.prim[own]]
    depth = hits.distance_m * (rays @ rotation[:, 2])
    return Labels(
        depth_z_m=depth.astype(np.float32).reshape(shape),
        distance_m=hits.distance_m.astype(np.float32).reshape(shape),
        normals=(hits.normal @ rotation).astype(np.float32).reshape(*shape, 3),
        uv=uv.reshape(*shape, 2),
        part_id=part.reshape(shape),
        instance_id=instance.reshape(shape),
        face_id=face.reshape(shape),
        barycentric=inside.astype(np.float32).reshape(*shape, 3),
        valid=(hits.solid != NOTHING).reshape(shape),
    )
