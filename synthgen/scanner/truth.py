"""The truth behind a pixel: what the true camera sees there, exactly, in float64."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, to_camera, undistort
from synthgen.geometry.normals import unit
from synthgen.render import backend
from synthgen.scanner.calibration import in_frame
from synthgen.scanner.glass import seen_position, shifted_origins
from synthgen.scanner.stage import Stage

Array = NDArray[np.float64]

_LIFT_M = 2e-5


@dataclass(frozen=True, eq=False)
class Sight:
    """What n rays through a camera's pixels meet first.

    Attributes
    ----------
    solid : (n,) int64
        Index into the scene's solids; -1 nothing, or the inside of an open mesh.
    face : (n,) int64
        Row of the solid's faces.
    barycentric : (n, 3) float64
    point_m : (n, 3) float64
        Rig frame, where the surface is at the time asked for; NaN where nothing is met.
    normal : (n, 3) float64
        Unit, of the flat face, outwards.
    depth_z_m : (n,) float64
        Along the true camera's axis, 0 nothing. Through glass it is the point's own depth.
    """

    solid: NDArray[np.int64]
    face: NDArray[np.int64]
    barycentric: Array
    point_m: Array
    normal: Array
    depth_z_m: Array


def see(stage: Stage, camera: Camera, pixels: NDArray[Any], *, time_s: float = 0.0) -> Sight:
    """Look through raw pixel positions of a true camera.

    Parameters
    ----------
    stage : Stage
    camera : Camera
        A true one.
    pixels : (n, 2) float
        x, y in the raw (distorted) picture, integer pixel centres.
    time_s : float
        When; the middle of the unit's exposure is ``Exposure.time_s``.
    """
    stage.pose(time_s)
    shift = stage.shift(time_s)
    flat = (np.asarray(pixels, np.float64) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    flat = undistort(camera, flat)
    rays = unit(np.column_stack([flat, np.ones(len(flat))]) @ camera.T[:3, :3].T)
    origins = shifted_origins(stage.rig.glass, camera.position, rays) - shift
    prim = _first(stage, origins, rays)
    corners = stage.vertices[stage.mesh.faces[np.maximum(prim, 0)]]
    barycentric, along, normal = _meet(corners, origins, rays)
    there = (prim >= 0) & (np.einsum("nk,nk->n", normal, rays) < 0)
    solid, face, inside = stage.mesh.parent(np.maximum(prim, 0), barycentric)
    point = origins + along[:, None] * rays + shift
    point[~there] = np.nan
    depth = np.where(there, to_camera(camera, np.where(there[:, None], point, 0))[:, 2], 0.0)
    solid[~there] = -1
    return Sight(solid, face, inside, point, normal, depth)


def _first(stage: Stage, origins: Array, rays: Array) -> NDArray[np.int64]:
    """Return the drawn triangle that each ray meets first, -1 none."""
    mi: Any = backend.mitsuba()
    if not len(rays):  # no lanes would end the process
        return np.zeros(0, dtype=np.int64)
    o = mi.Point3f(origins.T.astype(np.float32))
    d = mi.Vector3f(rays.T.astype(np.float32))
    hit = stage.scene.ray_intersect_preliminary(mi.Ray3f(o, d))
    backend.drjit().eval(hit)
    prim = np.array(hit.prim_index).astype(np.int64)
    prim[~np.array(hit.is_valid())] = -1
    return prim


def _meet(corners: Array, origins: Array, rays: Array) -> tuple[Array, Array, Array]:
    """Barycentrics, clipped into the triangle, distance along the ray, and face normal."""
    a = corners[:, 0]
    u, v = corners[:, 1] - a, corners[:, 2] - a
    normal = np.cross(u, v)
    along = np.einsum("nk,nk->n", a - origins, normal) / np.einsum("nk,nk->n", rays, normal)
    p = origins + along[:, None] * rays - a
    area = np.einsum("nk,nk->n", normal, normal)
    wb = np.einsum("nk,nk->n", np.cross(p, v), normal) / area
    wc = np.einsum("nk,nk->n", np.cross(u, p), normal) / area
    weights = np.maximum(np.stack([1 - wb - wc, wb, wc], axis=1), 0)
    return weights / weights.sum(axis=1, keepdims=True), along, unit(normal)


def seen_from(
    stage: Stage, camera: Camera, points_m: NDArray[Any], *, time_s: float = 0.0
) -> NDArray[np.bool_]:
    """Return which surface points (n, 3), as they are at a time, a true camera sees, (n,)."""
    mi: Any = backend.mitsuba()
    stage.pose(time_s)
    points = np.asarray(points_m, dtype=np.float64)
    if not len(points):  # no lanes would end the process
        return np.zeros(0, dtype=bool)
    known = np.asarray(np.isfinite(points).all(axis=1))
    points = np.where(known[:, None], points, 0.0)
    eyes = seen_position(stage.rig.glass, camera.position, points)
    way = eyes - points
    distance = np.linalg.norm(way, axis=1)
    way = way / distance[:, None]
    start = points - stage.shift(time_s) + _LIFT_M * way
    ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(way.T.astype(np.float32)))
    ray.maxt = mi.Float((0.999 * distance).astype(np.float32))
    free = ~np.array(stage.scene.ray_test(ray))
    shown = _in_picture(stage, camera, points, eyes)
    return np.asarray(free & known & shown)


def _in_picture(stage: Stage, camera: Camera, points: Array, eyes: Array) -> NDArray[np.bool_]:
    """Frame test of points seen from where the glass makes the eye stand."""
    return in_frame(camera, points - (eyes - camera.position))
