"""Analytic speckle pictures of planes and spheres: rays, a solid pattern, no renderer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

from synthgen.geometry.cameras import Camera, camera_from_K, pixel_rays
from synthgen.geometry.transforms import look_at
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
Surface = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Plane:
    """Through the origin, tilted about the y axis; distance along rays."""

    tilt_deg: float = 0.0

    def __call__(self, origin: Array, rays: Array) -> Array:
        a = np.deg2rad(self.tilt_deg)
        normal = np.array([np.sin(a), 0, np.cos(a)])
        return np.asarray(-(origin @ normal) / (rays @ normal))


@dataclass(frozen=True)
class Sphere:
    """Around the origin; NaN where a ray misses."""

    radius_m: float

    def __call__(self, origin: Array, rays: Array) -> Array:
        b = rays @ origin
        under = b**2 - origin @ origin + self.radius_m**2
        return np.asarray(-b - np.sqrt(np.where(under > 0, under, np.nan)))


def pair_of_cameras(
    width: int = 320, height: int = 240, f: float = 3243.0, baseline_m: float = 0.12,
    distortion: tuple[float, ...] = (0.0,) * 5,
) -> tuple[Camera, Camera]:  # fmt: skip
    """Two toed-in cameras 0.6 m from the origin on the +z side, y up."""
    K = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])
    cameras = []
    for side in (-0.5, 0.5):
        T = look_at(np.array([side * baseline_m, 0, 0.6]), np.zeros(3))
        cameras.append(camera_from_K(K, width, height, T, np.array(distortion)))
    return cameras[0], cameras[1]


def pattern(dot_m: float, seed: int, extent_m: float = 0.16) -> Callable[[Array], Array]:
    """Random speckle along z, 0..1, as a function of points (..., 3)."""
    texel = dot_m / 5
    n = int(extent_m / texel)
    noise = stream(seed, "sample", 0, 0, "pattern").standard_normal((n, n))
    smooth = gaussian_filter(noise, 5 / 2.355, mode="wrap")
    light = 1 / (1 + np.exp(-6 * smooth / smooth.std()))
    table = spline_filter(light, mode="grid-wrap")

    def look(points: Array) -> Array:
        at = np.moveaxis(points[..., :2] / texel + n / 2, -1, 0)
        return np.asarray(map_coordinates(table, at, mode="grid-wrap", prefilter=False))

    return look


def photograph(
    surface: Surface, light: Callable[[Array], Array], camera: Camera, spp: int = 3
) -> Array:
    """Box-filtered picture (H, W), 0..255, black where the surface is missed."""
    total = np.zeros((camera.height, camera.width))
    steps = (np.arange(spp) + 0.5) / spp - 0.5
    for dx in steps:
        for dy in steps:
            moved = camera_from_K(
                camera.K - [[0, 0, dx], [0, 0, dy], [0, 0, 0]], camera.width, camera.height,
                camera.T, np.array(camera.distortion),
            )  # fmt: skip
            origin, rays = pixel_rays(moved)
            t = surface(origin, rays)
            points = origin + rays * np.nan_to_num(t)[..., None]
            total += np.where(np.isfinite(t), 20 + 180 * light(points), 2)
    return total / spp**2


def expose(picture: Array, rng: np.random.Generator, sigma: float = 1.5) -> NDArray[np.uint8]:
    """Gaussian noise of ``sigma`` counts, 8 bits."""
    noisy = picture + sigma * rng.standard_normal(picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def true_disparity(surface: Surface, pair: Any) -> Array:
    """Disparity (H, W) that a rectified pair would measure without error."""
    origin, rays = pixel_rays(pair.camera)
    z = surface(origin, rays) * (rays @ pair.camera.T[:3, 2])
    return np.asarray(pair.disparity(z))


def rectified_view(surface: Surface, dot_m: float = 0.0008) -> tuple[Any, Any, Any, Array]:
    """One noisy exposure by distorted, toed-in cameras: pair, left, right, true disparity."""
    from synthgen.scanner.rectify import rectify, rectify_images

    cameras = pair_of_cameras(distortion=(-0.12, 0.05, 0.0, 0.0, 0.0))
    pair = rectify(*cameras)
    rng, light = stream(0, "sample", 0, 0, "noise"), pattern(dot_m, 1)
    raw = [expose(photograph(surface, light, camera), rng) for camera in cameras]
    left, right = rectify_images(pair, (raw[0], raw[1]))
    return pair, left, right, true_disparity(surface, pair)


def ring_of_grids(surface: Surface, azimuths: Any, elevations: Any) -> list[Any]:
    """Range grids without error of pairs around the origin, 0.6 m away."""
    from synthgen.scanner.match import DisparityGrid
    from synthgen.scanner.range_grid import range_grid
    from synthgen.scanner.rectify import rectify

    K = np.array([[3243.0, 0, 160], [0, 3243.0, 160], [0, 0, 1]])
    grids = []
    for azimuth, elevation in [(a, e) for a in azimuths for e in elevations]:
        a, e = np.deg2rad([azimuth, elevation])
        eye = 0.6 * np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        aside = 0.06 * np.array([np.cos(a), 0, -np.sin(a)])
        poses = [look_at(eye + s * aside, np.zeros(3)) for s in (-1, 1)]
        pair = rectify(*(camera_from_K(K, 321, 321, T) for T in poses))
        d = true_disparity(surface, pair)[::3, ::3].astype(np.float32)
        seen = np.where(np.isfinite(d), 1, 0).astype(np.float32)
        grids.append(range_grid(pair, DisparityGrid(d, np.full_like(d, 0.01), seen, 3, (321, 321))))
    return grids
