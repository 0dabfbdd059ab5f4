"""Speckle light without tricks: every ray against every triangle, in NumPy and float64.

For tests. It knows nothing of Dr.Jit, of light kept at vertices or of packed texels, and holds
``light`` and ``camera`` to the model: direct light of the projectors, ambient light, gloss, glass.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, undistort
from synthgen.geometry.normals import face_cross, unit
from synthgen.scanner.glass import seen_position, shifted_origins, thickness_for, transmittance
from synthgen.scanner.mesh import DrawnMesh
from synthgen.scanner.pattern import pyramid, slide
from synthgen.scanner.rig import Projector, Rig

Array = NDArray[np.float64]
_LIFT_M = 2e-5
_F0 = 0.04


def radiance(mesh: DrawnMesh, rig: Rig, camera: Camera, pixels: NDArray[Any], slot: int) -> Array:
    """Return the radiance (n,) along the rays through raw pixel positions (n, 2), scene at rest.

    Without bounce and without blur below the skin; ambient light is even.
    """
    flat = (np.asarray(pixels, float) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    rays = unit(np.column_stack([undistort(camera, flat), np.ones(len(flat))]) @ camera.T[:3, :3].T)
    origins = shifted_origins(rig.glass, camera.position, rays)
    face, distance, weights = first_hit(mesh.vertices, mesh.faces, origins, rays)
    hit = face >= 0
    outward = unit(face_cross(mesh.vertices, mesh.faces))[np.maximum(face, 0)]
    front = hit & (np.einsum("nk,nk->n", outward, rays) < 0)
    corners = mesh.faces[np.maximum(face, 0)]
    normal = unit(np.einsum("nk,nkj->nj", weights, mesh.normals[corners]))
    point = origins + distance[:, None] * rays
    surfaces = [mesh.parts[k].solid.surface for k in mesh.solid_of_face[np.maximum(face, 0)]]
    albedo = np.array([s.albedo for s in surfaces])
    total = albedo * rig.light.ambient
    for projector in (p for p in rig.projectors if p.slot == slot):
        light, way = _arriving(projector, rig, point)
        cosine = np.einsum("nk,nk->n", normal, way)
        reach = front & (light > 0) & (cosine > 0)
        start = point + _LIFT_M * outward
        blocked = np.ones(len(point), dtype=bool)
        length = np.linalg.norm(projector.optics.position - point, axis=1)
        at = np.flatnonzero(reach)
        face_at, far, _ = first_hit(mesh.vertices, mesh.faces, start[at], way[at])
        blocked[at] = (face_at >= 0) & (far < 0.999 * length[at])
        irradiance = np.where(reach & ~blocked, light * cosine, 0)
        total += irradiance * (albedo + _gloss(surfaces, normal, way, -rays))
    cosine = np.abs(rays[:, 1])
    if rig.glass is not None and thickness_for(rig.glass, camera.position):
        total = total * transmittance(cosine, rig.glass.ior)
    return np.where(front, total, np.where(hit, 0.0, rig.light.background))


def first_hit(
    vertices: Array, faces: NDArray[np.int64], origins: Array, rays: Array
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return face (-1 none), distance and corner weights of the first hits, ray by ray."""
    a = vertices[faces[:, 0]]
    u, v = vertices[faces[:, 1]] - a, vertices[faces[:, 2]] - a
    found, distance = np.full(len(rays), -1), np.zeros(len(rays))
    weights = np.zeros((len(rays), 3))
    for k, (origin, ray) in enumerate(zip(origins, rays, strict=True)):
        p = np.cross(ray, v)
        determinant = np.einsum("fk,fk->f", u, p)
        determinant = np.where(np.abs(determinant) < 1e-300, np.nan, determinant)
        s = origin - a
        wb = np.einsum("fk,fk->f", s, p) / determinant
        q = np.cross(s, u)
        wc = (q @ ray) / determinant
        t = np.einsum("fk,fk->f", v, q) / determinant
        inside = (wb >= 0) & (wc >= 0) & (wb + wc <= 1) & (t > 0)
        if inside.any():
            f = int(np.where(inside, t, np.inf).argmin())
            found[k], distance[k] = f, t[f]
            weights[k] = 1 - wb[f] - wc[f], wb[f], wc[f]
    return found, distance, weights


def _arriving(projector: Projector, rig: Rig, points: Array) -> tuple[Array, Array]:
    """Irradiance on facing surfaces, slide included, and direction to the light, (n,), (n, 3)."""
    optics = projector.optics
    way = seen_position(rig.glass, optics.position, points) - points
    distance = np.linalg.norm(way, axis=1)
    way = way / distance[:, None]
    local = -way @ optics.T[:3, :3]
    ahead = local[:, 2]
    texel = local[:, :2] / ahead[:, None] * optics.fx + [optics.cx, optics.cy]
    inside = (ahead > 0.01) & ((texel > 0) & (texel < optics.width - 1)).all(axis=1)
    depth = (points - optics.position) @ optics.T[:3, 2]
    sigma = projector.aperture_m * optics.fx / 4 * np.abs(1 / depth - 1 / projector.focus_m)
    shown = _slide(projector, texel, sigma)
    falloff = projector.irradiance * (projector.focus_m / distance) ** 2
    falloff = falloff * np.maximum(ahead, 0.01) ** projector.vignetting
    if rig.glass is not None and thickness_for(rig.glass, optics.position):
        falloff = falloff * transmittance(np.abs(way[:, 1]), rig.glass.ior)
    return np.where(inside, falloff * shown, 0), way


def _slide(projector: Projector, texel: Array, sigma: Array) -> Array:
    """Interpolate the pyramid's levels by variance; sigmas of the levels are 0, 2, 4, 8, 16."""
    levels = pyramid(slide(projector.pattern, projector.optics.width))
    sigmas = np.array([0.0, *2.0 ** np.arange(1, len(levels))])
    values = np.stack([_bilinear(level, texel, 2.0**k) for k, level in enumerate(levels)])
    return np.array([np.interp(s * s, sigmas**2, column) for s, column in
                     zip(sigma, values.T, strict=True)])  # fmt: skip


def _bilinear(level: NDArray[np.uint8], texel: Array, scale: float) -> Array:
    n = len(level)
    at = np.clip((texel + 0.5) / scale - 0.5, 0, n - 1.001)
    low = at.astype(int)
    x, y = (at - low).T
    column, row = low.T
    wide = np.pad(level, ((0, 1), (0, 1)), mode="edge").astype(float) / 255
    top = wide[row, column] * (1 - x) + wide[row, column + 1] * x
    bottom = wide[row + 1, column] * (1 - x) + wide[row + 1, column + 1] * x
    return np.asarray(top * (1 - y) + bottom * y)


def _gloss(surfaces: list[Any], normal: Array, way: Array, view: Array) -> Array:
    """GGX with Smith's shadowing and Schlick's Fresnel term: pi times the BRDF."""
    half = unit(way + view)
    nh = np.maximum(np.einsum("nk,nk->n", normal, half), 0)
    nl = np.einsum("nk,nk->n", normal, way)
    nv = np.maximum(np.einsum("nk,nk->n", normal, view), 0.05)
    alpha2 = np.array([max(s.roughness, 0.05) ** 4 for s in surfaces])
    weight = np.array([s.specular for s in surfaces])
    spread = alpha2 / (nh * nh * (alpha2 - 1) + 1) ** 2
    shadow = [2 * c / (c + np.sqrt(alpha2 + (1 - alpha2) * c * c)) for c in (np.abs(nl), nv)]
    fresnel = _F0 + (1 - _F0) * (1 - np.einsum("nk,nk->n", view, half)) ** 5
    lobe = spread * fresnel * shadow[0] * shadow[1] / (4 * nv * np.maximum(nl, 1e-3))
    return np.asarray(weight * lobe)
