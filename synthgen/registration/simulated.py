"""Noisy partial scans from a z-buffer: what tests, benchmarks and the initialiser's training use.

No renderer: several pinhole depth cameras around a mesh, merged; occlusion, grazing angles and the
open wrist are as a depth camera has them; noise is along the normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, camera_from_K
from synthgen.geometry.normals import incidence, unit, vertex_normals
from synthgen.geometry.raster import rasterise
from synthgen.geometry.transforms import look_at
from synthgen.registration.scan import nearest

Array = NDArray[np.float64]
DISTANCE_M, GRAZING_COSINE = 0.6, 0.25


@dataclass(frozen=True)
class ScanSettings:
    """How a simulated scan is taken.

    Attributes
    ----------
    views : int
        Depth cameras, in random directions at 0.6 m.
    points : int
        Points kept at most.
    noise_m : float
        Standard deviation along the normal, metres.
    normal_noise : float
        Standard deviation added to each coordinate of the unit normals.
    holes : int
        Round holes of 5-9 mm radius.
    outliers : float
        Share of points scattered in the scan's box.
    pixels : int
        Side of each camera's square picture.
    """

    views: int = 3
    points: int = 50_000
    noise_m: float = 2e-4
    normal_noise: float = 0.15
    holes: int = 3
    outliers: float = 0.01
    pixels: int = 260


def simulate_scan(
    vertices: NDArray[Any], faces: NDArray[Any], settings: ScanSettings, *, rng: np.random.Generator
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Scan a mesh.

    Returns
    -------
    points, normals : (N, 3) float64
        World, metres; outward.
    seen : (V,) bool
        Vertices within 2.5 mm of a scan point.
    """
    from scipy.spatial import cKDTree

    mesh = np.asarray(vertices, dtype=np.float64)
    smooth = vertex_normals(mesh, faces)
    views = [view_points(mesh, faces, smooth, c)
             for c in cameras_around(mesh, settings.views, settings.pixels, rng=rng)]  # fmt: skip
    p, n = (np.concatenate(part) for part in zip(*views, strict=True))
    for _ in range(settings.holes):
        centre, radius = p[rng.integers(len(p))], rng.uniform(0.005, 0.009)
        keep = np.linalg.norm(p - centre, axis=1) > radius
        p, n = p[keep], n[keep]
    chosen = rng.permutation(len(p))[: settings.points]
    p, n = p[chosen], n[chosen]
    seen = nearest(cKDTree(p), mesh)[0] < 0.0025
    p = p + n * rng.normal(0, settings.noise_m, (len(p), 1))
    n = unit(n + rng.normal(0, settings.normal_noise, n.shape))
    wild = rng.random(len(p)) < settings.outliers
    low, high = p.min(axis=0), p.max(axis=0)
    p[wild] = rng.uniform(low, high, (int(wild.sum()), 3))
    return p, n, seen


def cameras_around(
    vertices: Array, count: int, pixels: int, *, rng: np.random.Generator
) -> list[Camera]:
    """Cameras (count) in random directions that all see the whole mesh."""
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    distance = max(DISTANCE_M, 2.5 * radius)
    focal = 0.48 * pixels * (distance - radius) / radius
    middle = pixels / 2 - 0.5
    K = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    cameras = []
    for direction in unit(rng.standard_normal((count, 3))):
        eye = centre + distance * direction
        up = (0.0, 1.0, 0.0) if abs(direction[1]) < 0.9 else (1.0, 0.0, 0.0)
        cameras.append(camera_from_K(K, pixels, pixels, look_at(eye, centre, up)))
    return cameras


def view_points(
    vertices: Array, faces: NDArray[Any], normals: Array, camera: Camera
) -> tuple[Array, Array]:
    """Points and outward normals (n, 3) of the surface that one camera sees, not grazing."""
    face, barycentric, _ = rasterise(vertices, faces, camera)
    on = face >= 0
    corners, b = np.asarray(faces)[face[on]], barycentric[on]
    points = np.einsum("nk,nka->na", b, vertices[corners])
    outward = unit(np.einsum("nk,nka->na", b, normals[corners]))
    towards = unit(camera.position - points)
    seen = np.sum(outward * towards, axis=1) > GRAZING_COSINE
    return points[seen], outward[seen]


def with_detail(
    vertices: NDArray[Any],
    faces: NDArray[Any],
    amplitude_m: float,
    *,
    rng: np.random.Generator,
    rough: float = 0.0,
) -> Array:
    """Add detail that no model expresses: bumps along the normals.

    ``amplitude_m`` is the standard deviation of the displacement; the share ``rough`` of its
    variance is independent per vertex (wrinkles), the rest smooth (elastic tissue).
    """
    mesh = np.asarray(vertices, dtype=np.float64)
    touch = incidence(faces, len(mesh))
    graph = (touch @ touch.T).tocsr()
    mean = graph.multiply(1 / np.maximum(np.asarray(graph.sum(axis=1)), 1e-12)).tocsr()
    smooth = rng.standard_normal(len(mesh))
    for _ in range(6):
        smooth = mean @ smooth
    white = rng.standard_normal(len(mesh))
    bump = np.sqrt(1 - rough) * smooth / smooth.std() + np.sqrt(rough) * white
    bump *= amplitude_m / bump.std()
    result: Array = mesh + bump[:, None] * vertex_normals(mesh, faces)
    return result


def with_shape(
    vertices: NDArray[Any], amplitude_m: float, *, rng: np.random.Generator, longest_m: float = 0.3
) -> Array:
    """Add a shape that no component expresses: a smooth field of offsets in all directions.

    ``amplitude_m`` is its mean length; its waves are a third of ``longest_m`` to ``longest_m``.
    """
    mesh = np.asarray(vertices, dtype=np.float64)
    directions = unit(rng.standard_normal((12, 3)))
    waves = 2 * np.pi * directions / rng.uniform(longest_m / 3, longest_m, (12, 1))
    phase = mesh @ waves.T + rng.uniform(0, 2 * np.pi, 12)
    offset = np.cos(phase) @ rng.standard_normal((12, 3))
    result: Array = mesh + offset * (amplitude_m / np.linalg.norm(offset, axis=1).mean())
    return result
