"""A picture of a fit: the scan, the model, and the model coloured by its distance from the scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, camera_from_K
from synthgen.geometry.normals import unit, vertex_normals
from synthgen.geometry.raster import rasterise
from synthgen.geometry.transforms import look_at

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class _Look:
    """How a subject is drawn: pixels, distances of red and grey, what dots lie behind the skin."""

    size: int
    worst_m: float
    unseen_m: float
    behind_m: float
    distance: float
    dots: int


SIZE = 320
HAND = _Look(SIZE, 1e-3, 3e-3, 0.004, 0.8, 6000)
BODY = _Look(480, 3e-3, 12e-3, 0.010, 4.0, 20_000)
CLOSE = _Look(480, 3e-3, 6e-3, 0.006, 0.8, 6000)
BODY_RADIUS_M, CLOSE_MARGIN_M = 0.35, 0.03
MOST_POINTS = 20_000


def draw_overlay(
    points: NDArray[Any],
    vertices: NDArray[Any],
    faces: NDArray[Any],
    title: str = "",
    close: Sequence[NDArray[np.int64]] = (),
    seen_like: NDArray[Any] | None = None,
) -> Picture:
    """Draw three columns (scan; scan over model; distance) from three sides.

    Distances run from green (0) over yellow to red (1 mm and more); skin farther than 3 mm from
    every scan point is grey: not seen. Bodies: 3 mm and 12 mm, upright; a row for each close-up.

    Parameters
    ----------
    points : (N, 3) float, metres
    vertices : (V, 3) float, metres
    faces : (F, 3) int
    title : str
    close : sequence of (m,) int
        Vertices to look at closely, such as a body's hands.
    seen_like : (W, 3) float, metres, optional
        Look from where these would be looked at from, to compare two pictures.

    Returns
    -------
    (H, W, 3) uint8, sRGB
    """
    scan, mesh = np.asarray(points, np.float64), np.asarray(vertices, np.float64)
    scan = scan[np.isfinite(scan).all(axis=1)]
    like = mesh if seen_like is None else np.asarray(seen_like, np.float64)
    rows = _rows(scan, mesh, faces, BODY if _radius(mesh) > BODY_RADIUS_M else HAND, like)
    for ids in close:
        own = np.isin(faces, ids).all(axis=1)
        used, inner = np.unique(faces[own], return_inverse=True)
        part = mesh[used]
        low, high = part.min(axis=0) - CLOSE_MARGIN_M, part.max(axis=0) + CLOSE_MARGIN_M
        near = scan[((scan > low) & (scan < high)).all(axis=1)]
        rows += _rows(near, part, inner.reshape(-1, 3), CLOSE, part)[:1]
    return _titled(np.vstack(rows), title)


def _radius(mesh: Array) -> float:
    middle = (mesh.min(axis=0) + mesh.max(axis=0)) / 2
    return float(np.linalg.norm(mesh - middle, axis=1).max())


def _rows(scan: Array, mesh: Array, faces: NDArray[Any], look: _Look, like: Array) -> list[Picture]:
    from scipy.spatial import cKDTree

    scan = _spread(scan, MOST_POINTS)
    plane = _plane_distance(scan, mesh, faces, look.unseen_m)
    distance = cKDTree(scan).query(mesh)[0] if len(scan) else np.full(len(mesh), np.inf)
    colours = error_colours(np.where(distance < look.unseen_m, plane, np.inf), look.worst_m)
    cameras = _cameras(like, _radius(like), look)
    return [np.hstack(_row(scan, mesh, faces, colours, camera, look)) for camera in cameras]


def save_overlay(path: Path, picture: Picture) -> None:
    """Write a PNG."""
    import cv2

    # not by imwrite: a path that is no UTF-8 crashes it
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes())


def error_colours(distance_m: Array, worst_m: float = HAND.worst_m) -> Array:
    """Colours (V, 3) in 0..1 of distances; infinite is grey."""
    share = np.clip(np.where(np.isfinite(distance_m), distance_m, 0) / worst_m, 0, 1)[:, None]
    low, middle, high = (np.array(c) for c in ([0.2, 0.7, 0.3], [0.95, 0.85, 0.2], [0.8, 0.1, 0.1]))
    warm = np.where(share < 0.5, low + 2 * share * (middle - low),
                    middle + (2 * share - 1) * (high - middle))  # fmt: skip
    return np.where(np.isfinite(distance_m)[:, None], warm, 0.6)


def _spread(points: Array, most: int) -> Array:
    """At most so many points, evenly out of all: scanners store neighbours one after the other."""
    return points[:: -(-len(points) // most)] if len(points) > most else points


def _plane_distance(scan: Array, mesh: Array, faces: NDArray[Any], unseen_m: float) -> Array:
    """Mean distance of the scan points around each vertex from the mesh (V,), inf without any."""
    import igl

    if len(scan) == 0:
        return np.full(len(mesh), np.inf)
    f = np.ascontiguousarray(faces, dtype=np.int64)
    squared, face = igl.point_mesh_squared_distance(scan, mesh, f)[:2]
    near = squared < unseen_m**2  # else the arm's points would count for the wrist's rim
    ids, d = f[face[near]].ravel(), np.repeat(np.sqrt(squared[near]), 3)
    count = np.bincount(ids, minlength=len(mesh))
    mean = np.bincount(ids, d, len(mesh)) / np.maximum(count, 1)
    return np.asarray(np.where(count > 0, mean, np.inf))


def _cameras(mesh: Array, radius: float, look: _Look) -> list[Camera]:
    centre = (mesh.min(axis=0) + mesh.max(axis=0)) / 2
    axes = np.linalg.svd(mesh - centre, full_matrices=False)[2]
    if look is BODY and axes[0, 1] < 0:
        axes[0] *= -1  # heads up
    size, away = look.size, look.distance
    focal = 0.46 * size * (away - radius) / radius
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    views = (axes[2], -axes[2], unit(axes[1] + 0.3 * axes[2]))
    up = tuple(float(v) for v in axes[0])
    return [camera_from_K(K, size, size, look_at(centre + away * d, centre, (up[0], up[1], up[2])))
            for d in views]  # fmt: skip


def _row(
    scan: Array, mesh: Array, faces: NDArray[Any], colours: Array, camera: Camera, look: _Look
) -> list[Picture]:
    normals = vertex_normals(mesh, faces)
    face, b, depth = rasterise(mesh, faces, camera)
    on = face >= 0
    corner = np.asarray(faces)[face[on]]
    n = unit(np.einsum("nk,nka->na", b[on], normals[corner]))
    towards = unit(camera.position - mesh.mean(axis=0))
    light = 0.25 + 0.75 * np.abs(n @ towards)
    size = look.size
    model = np.full((size, size, 3), 1.0)
    model[on] = light[:, None] * np.array([0.85, 0.78, 0.74])
    errors = np.full((size, size, 3), 1.0)
    errors[on] = light[:, None] * np.einsum("nk,nka->na", b[on], colours[corner])
    alone = np.full((size, size, 3), 1.0)
    both = model.copy()
    _dots(alone, scan, camera, np.zeros_like(depth), look)
    _dots(both, _spread(scan, look.dots), camera, depth, look)
    return [np.asarray(255 * np.clip(p, 0, 1) + 0.5, np.uint8) for p in (alone, both, errors)]


def _dots(picture: Array, scan: Array, camera: Camera, depth: Array, look: _Look) -> None:
    """Scan points in blue, nearer ones darker; points well behind the model are hidden."""
    if len(scan) == 0:
        return
    local = (scan - camera.position) @ camera.T[:3, :3]
    z = local[:, 2]
    u = np.rint(local[:, 0] / z * camera.fx + camera.cx).astype(int)
    v = np.rint(local[:, 1] / z * camera.fy + camera.cy).astype(int)
    inside = (u >= 0) & (u < look.size) & (v >= 0) & (v < look.size) & (z > 0)
    u, v, z = u[inside], v[inside], z[inside]
    shown = (depth[v, u] == 0) | (z < depth[v, u] + look.behind_m)
    order = np.argsort(-z[shown])
    u, v, z = u[shown][order], v[shown][order], z[shown][order]
    near, far = z.min(initial=0.7), z.max(initial=0.9)
    shade = (z - near) / max(far - near, 1e-6)
    picture[v, u] = np.stack([0.1 + 0.7 * shade, 0.2 + 0.6 * shade, 0.5 + 0.4 * shade], axis=1)


def _titled(picture: Picture, title: str) -> Picture:
    import cv2

    head = np.full((26, picture.shape[1], 3), 255, np.uint8)
    plain = title[:110].encode("ascii", "replace").decode()  # OpenCV has no other letters
    cv2.putText(head, plain, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (20, 20, 20), 1,
                cv2.LINE_AA)  # fmt: skip
    return np.vstack([head, picture])
