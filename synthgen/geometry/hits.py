"""Where rays meet the planes of triangles that are known to be hit, exactly, in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# A normal beyond the horizon comes back to it and a hair over, so that rounding keeps it there.
_OVER = 1.001


def meet(
    vertices: Array,
    triangles: NDArray[np.int64],
    normals: Array | None,
    rows: NDArray[np.int64],
    prim: NDArray[np.int64],
    origin: Array,
    rays: Array,
    out: tuple[Array, Array, Array],
) -> None:
    """Intersect rays with the planes of their triangles.

    Parameters
    ----------
    vertices : (V, 3) float64
        Metres.
    triangles : (F, 3) int64
    normals : (V, 3) float64 or None
        Vertex normals to interpolate; None for flat triangles.
    rows : (m,) int64
        Which of the n rays meet this mesh.
    prim : (n,) int64
        The triangle that each ray hits, rows of ``triangles``.
    origin : (3,) float64
        Of all rays, metres.
    rays : (n, 3) float64
        Directions; distances count in their lengths.
    out : barycentric (n, 3), distance (n,), normal (n, 3), float64
        Written at ``rows``: weights of the triangle's corners, clipped into it; distance; unit
        normal towards the origin. A smooth normal belongs to the side of the triangle that is
        seen; where interpolation turns it beyond the horizon, at silhouettes, it is laid on it.
    """
    smooth = np.zeros((0, 3)) if normals is None else normals
    _meet(vertices, triangles, smooth, rows, prim, origin, rays, *out)


@njit(cache=True, error_model="numpy")
def _meet(
    vertices: Any, triangles: Any, normals: Any, rows: Any, prim: Any, origin: Any, rays: Any,
    barycentric: Any, distance: Any, normal: Any,
) -> None:  # fmt: skip
    ox, oy, oz = origin[0], origin[1], origin[2]
    for i in rows:
        a, b, c = triangles[prim[i], 0], triangles[prim[i], 1], triangles[prim[i], 2]
        ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        ux, uy, uz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
        vx, vy, vz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        rx, ry, rz = rays[i, 0], rays[i, 1], rays[i, 2]
        along = ((ax - ox) * nx + (ay - oy) * ny + (az - oz) * nz) / (rx * nx + ry * ny + rz * nz)
        px, py, pz = ox + along * rx - ax, oy + along * ry - ay, oz + along * rz - az
        area = nx * nx + ny * ny + nz * nz
        # (p x v) . n / |n|^2 and (u x p) . n / |n|^2
        wb = ((py * vz - pz * vy) * nx + (pz * vx - px * vz) * ny + (px * vy - py * vx) * nz) / area
        wc = ((uy * pz - uz * py) * nx + (uz * px - ux * pz) * ny + (ux * py - uy * px) * nz) / area
        wa, wb, wc = max(1.0 - wb - wc, 0.0), max(wb, 0.0), max(wc, 0.0)
        total = wa + wb + wc
        wa, wb, wc = wa / total, wb / total, wc / total
        if nx * rx + ny * ry + nz * rz > 0:
            nx, ny, nz = -nx, -ny, -nz
        if len(normals):
            fx, fy, fz = nx, ny, nz
            nx = wa * normals[a, 0] + wb * normals[b, 0] + wc * normals[c, 0]
            ny = wa * normals[a, 1] + wb * normals[b, 1] + wc * normals[c, 1]
            nz = wa * normals[a, 2] + wb * normals[b, 2] + wc * normals[c, 2]
            if nx * fx + ny * fy + nz * fz < 0:
                nx, ny, nz = -nx, -ny, -nz
            beyond = nx * rx + ny * ry + nz * rz
            if beyond > 0:  # a flip would throw it to the other side of the outline
                beyond *= _OVER / (rx * rx + ry * ry + rz * rz)
                nx, ny, nz = nx - beyond * rx, ny - beyond * ry, nz - beyond * rz
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        barycentric[i, 0], barycentric[i, 1], barycentric[i, 2] = wa, wb, wc
        distance[i] = along
        normal[i, 0], normal[i, 1], normal[i, 2] = nx / length, ny / length, nz / length
