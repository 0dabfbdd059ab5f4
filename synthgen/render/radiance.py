"""Light transport along our own camera rays: one film for every lens.

Rays start where the label pass says pixels look, so that picture and labels agree under any lens;
a thin lens and sub-pixel jitter are added here. Sums per pixel are taken in a fixed order, so that
the bytes do not depend on threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, undistort
from synthgen.render import backend
from synthgen.render.skin import material
from synthgen.render.upload import LiveScene
from synthgen.scene import Optics

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# Largest number of light paths that are traced at once; it bounds memory.
MOST_PATHS = 4_000_000


@dataclass(frozen=True, eq=False)
class Guides:
    """What a denoiser, white balance and diffusion lean on, (H, W, 3) float32, anti-aliased.

    ``albedo`` in 0..1 (1 where nothing is hit); ``normal`` world frame, fine relief included, zero
    where nothing is hit.
    """

    albedo: Image
    normal: Image


def mean_guides(parts: list[Guides]) -> Guides:
    """Average guides of equal weight."""
    albedo = np.mean([part.albedo for part in parts], axis=0, dtype=np.float32)
    normal = np.mean([part.normal for part in parts], axis=0, dtype=np.float32)
    return Guides(np.asarray(albedo, np.float32), np.asarray(normal, np.float32))


class Film:
    """Traces one view of the uploaded scene.

    Parameters
    ----------
    live : LiveScene
        With the sample uploaded.
    camera : Camera
    optics : Optics
    """

    def __init__(self, live: LiveScene, camera: Camera, optics: Optics) -> None:
        self._live, self._camera = live, camera
        self._mi: Any = backend.mitsuba()
        self._dr: Any = backend.drjit()
        mi, dr = self._mi, self._dr
        self._centres = [mi.Float(backend.aligned(c)) for c in _pixel_map(camera)]
        T = camera.T

        def number(value: float) -> Any:
            return dr.opaque(mi.Float, float(value))

        self._origin = mi.Point3f(*(number(v) for v in T[:3, 3]))
        self._axes = [mi.Vector3f(*(number(v) for v in T[:3, k])) for k in range(3)]
        self._aperture, self._focus = number(optics.aperture_m), number(optics.focus_m)

    def radiance(self, spp: int, max_depth: int, seed: int) -> Image:
        """Return the mean of ``spp`` light paths per pixel; (H, W, 3) float32, linear sRGB."""
        # Russian roulette from the third segment on: a fifth of the cost less, as little noise.
        path = {"type": "path", "max_depth": max_depth, "rr_depth": 3}
        integrator = self._mi.load_dict(path)

        def trace(sampler: Any, ray: Any) -> Any:
            return integrator.sample(self._live.scene, sampler, ray)[0]

        return self._mean(spp, seed, trace, 3)

    def guides(self, spp: int, seed: int) -> Guides:
        """Return albedo and normals of what is seen first."""
        mi, dr = self._mi, self._dr

        def look(sampler: Any, ray: Any) -> Any:
            hit = self._live.scene.ray_intersect(ray)
            valid = hit.is_valid() & (dr.dot(hit.wi, hit.wi) > 0)
            lit = valid & (hit.emitter(self._live.scene) != None)  # noqa: E711  (a Dr.Jit mask)
            albedo = hit.bsdf(ray).eval_diffuse_reflectance(hit, valid & ~lit)
            albedo = dr.select(valid & ~lit, albedo, 1.0)
            normal = dr.select(valid, mi.Vector3f(hit.sh_frame.n), mi.Vector3f(0.0))
            for name, relief in self._live.bumps.items():
                own = valid & (hit.shape == mi.ShapePtr(self._live.shape(name)))
                bumped = material.bumped_normal(mi, dr, hit, relief, own)
                normal = dr.select(own, mi.Vector3f(bumped), normal)
            return [*albedo, *normal]

        both = self._mean(spp, seed, look, 6)
        return Guides(
            albedo=np.ascontiguousarray(np.clip(both[..., :3], 0, 1)),
            normal=np.ascontiguousarray(both[..., 3:]),
        )

    def _mean(self, spp: int, seed: int, trace: Any, channels: int) -> Image:
        """Average over samples per pixel, in passes that bound memory."""
        height, width = self._camera.height, self._camera.width
        per_pass = max(1, min(spp, MOST_PATHS // (height * width)))
        total = np.zeros((height * width, channels))
        done, number = 0, 0
        while done < spp:
            count = min(per_pass, spp - done)
            values = self._pass(count, (seed + 104_729 * number) % 2**31, trace)
            for channel, value in enumerate(values):
                rows = np.array(value, dtype=np.float32).reshape(-1, count)
                total[:, channel] += rows.sum(axis=1, dtype=np.float64)
            done, number = done + count, number + 1
        return np.asarray((total / spp).reshape(height, width, channels), dtype=np.float32)

    def _pass(self, count: int, seed: int, trace: Any) -> list[Any]:
        mi, dr = self._mi, self._dr
        n = self._camera.height * self._camera.width * count
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(dr.opaque(mi.UInt32, seed), n)
        pixel = dr.arange(mi.UInt32, n) // dr.opaque(mi.UInt32, count)
        values = list(trace(sampler, self._rays(sampler, pixel)))
        dr.eval(values)
        return values

    def _rays(self, sampler: Any, pixel: Any) -> Any:
        """One ray through a random point of each pixel and of the aperture."""
        mi, dr = self._mi, self._dr
        jitter = sampler.next_2d() - 0.5
        x, y, xu, yu, xv, yv = (dr.gather(mi.Float, c, pixel) for c in self._centres)
        x = x + xu * jitter.x + xv * jitter.y
        y = y + yu * jitter.x + yv * jitter.y
        lens = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d()) * self._aperture
        right, down, forward = self._axes
        offset = right * lens.x + down * lens.y
        towards = (right * x + down * y + forward) * self._focus - offset
        ray = mi.RayDifferential3f(mi.Ray3f(self._origin + offset, dr.normalize(towards)))
        ray.has_differentials = False
        return ray


def _pixel_map(camera: Camera) -> list[Array]:
    """Normalised undistorted coordinates of every pixel's centre, and their slopes in u and v.

    Six arrays (H W,): x, y, dx/du, dy/du, dx/dv, dy/dv. Within a pixel the lens is linear to well
    under a thousandth of a pixel.
    """
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)

    def looked_at(du: float, dv: float) -> Array:
        xy = np.stack([(u + du - camera.cx) / camera.fx, (v + dv - camera.cy) / camera.fy], axis=-1)
        return undistort(camera, xy)

    centre = looked_at(0.0, 0.0)
    across = looked_at(0.5, 0.0) - looked_at(-0.5, 0.0)
    down = looked_at(0.0, 0.5) - looked_at(0.0, -0.5)
    return [np.ravel(c[..., k]) for c in (centre, across, down) for k in (0, 1)]
