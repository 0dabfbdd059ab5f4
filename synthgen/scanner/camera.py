"""The speckle picture on the device: rays of true cameras, stratified over pixel and time.

Everything that distinguishes cameras is data, so one kernel makes the pictures of all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isqrt
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ConfigError
from synthgen.geometry.cameras import Camera
from synthgen.render import backend
from synthgen.scanner.glass import normal_shift, thickness_for, transmittance
from synthgen.scanner.light import LIFT_M, Gloss, irradiance, number
from synthgen.scanner.rig import Sensor
from synthgen.scanner.softlight import SoftLight, share_of
from synthgen.scanner.stage import Stage

Array = NDArray[np.float64]

_LEAST_STEPS, _MOST_STEPS, _SETTLED_PX = 6, 96, 1e-3
# Pixels per edge of the blocks in which the subject is looked for.
_BLOCK_PX = 4


@dataclass(frozen=True)
class Shutter:
    """When a picture is taken.

    Attributes
    ----------
    time_s : float
        Middle of the exposure of the middle row.
    exposure_s, line_delay_s : float
    """

    time_s: float
    exposure_s: float
    line_delay_s: float

    def span(self, height: int) -> tuple[float, float]:
        """Return when the first row begins and the last one ends."""
        half = 0.5 * (self.exposure_s + self.line_delay_s * (height - 1))
        return self.time_s - half, self.time_s + half


def shutter_of(sensor: Sensor, time_s: float) -> Shutter:
    """Return the shutter of a sensor that exposes at a time."""
    return Shutter(time_s, sensor.exposure_s, sensor.line_delay_s)


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays on the device, in the scene's pose: origin, unit direction, transmittance of glass."""

    origin: Any
    way: Any
    passed: Any


# From rays, the scene's shift and the active lanes to what is seen, per channel.
Look = Callable[[Rays, Any, Any], tuple[Any, ...]]


class Lens:
    """A true camera's numbers on the device."""

    def __init__(self, stage: Stage, camera: Camera):
        T = camera.T
        self.width, self.height = camera.width, camera.height
        self.focal = number(camera.fx), number(camera.fy)
        self.centre = number(camera.cx), number(camera.cy)
        self.coefficients = [number(v) for v in camera.distortion]
        self.steps = undistort_steps(camera)
        self.axes = [[number(v) for v in row] for row in T[:3, :3]]
        self.eye = [number(v) for v in camera.position]
        self.thickness = number(thickness_for(stage.rig.glass, camera.position))
        self.ior = None if stage.rig.glass is None else number(stage.rig.glass.ior)

    def rays(self, x: Any, y: Any, shift: Any) -> Rays:
        """Return rays through raw pixel positions of a scene that has moved by ``shift``."""
        mi: Any = backend.mitsuba()
        dr: Any = backend.drjit()
        u, v = self._flat(
            (x - self.centre[0]) / self.focal[0], (y - self.centre[1]) / self.focal[1]
        )
        way = dr.normalize(mi.Vector3f(*(a[0] * u + a[1] * v + a[2] for a in self.axes)))
        origin = mi.Point3f(*self.eye) - shift
        passed = mi.Float(1)
        if self.ior is not None:
            cosine = dr.abs(way.y)
            move = normal_shift(cosine, self.thickness, self.ior, dr.sqrt)
            origin.y += dr.sign(way.y) * move
            through = transmittance(cosine, self.ior, dr.sqrt)
            passed = dr.select(self.thickness > 0, through, 1)
        return Rays(origin, way, passed)

    def _flat(self, xd: Any, yd: Any) -> tuple[Any, Any]:
        """Undo Brown-Conrady distortion by fixed-point iteration, as ``cameras.undistort``."""
        x, y = xd, yd
        for _ in range(self.steps):
            x, y = _nearer(xd, yd, x, y, self.coefficients)
        return x, y


def _nearer(xd: Any, yd: Any, x: Any, y: Any, coefficients: Sequence[Any]) -> tuple[Any, Any]:
    """One step from a guess (x, y) towards the point that distortion takes to (xd, yd)."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return (xd - dx) / radial, (yd - dy) / radial


@lru_cache(maxsize=256)
def undistort_steps(camera: Camera) -> int:
    """Return how many steps undo a camera's distortion all over its picture to 0.001 pixels.

    At least six: usual lenses need no more, so that all of them share one compiled kernel.

    Raises
    ------
    ConfigError
        If the steps do not settle: the distortion folds the picture.
    """
    across = (np.linspace(-0.5, camera.width - 0.5, 9) - camera.cx) / camera.fx
    down = (np.linspace(-0.5, camera.height - 0.5, 9) - camera.cy) / camera.fy
    xd, yd = np.meshgrid(across, down)
    x, y = xd, yd
    with np.errstate(all="ignore"):
        for step in range(1, _MOST_STEPS + 1):
            before = x, y
            x, y = _nearer(xd, yd, x, y, camera.distortion)
            moved = camera.fx * float(np.max(np.hypot(x - before[0], y - before[1])))
            if moved < _SETTLED_PX and step >= _LEAST_STEPS:
                return step
    raise ConfigError(
        f"distortion {camera.distortion} folds the picture of a camera with {camera.width}x"
        f"{camera.height} pixels and a focal length of {camera.fx:.0f}: use smaller coefficients, "
        "or a narrower field (a smaller gsd_m or fewer pixels)"
    )


def region(stage: Stage, camera: Camera, shutter: Shutter) -> NDArray[np.uint32]:
    """Return the raw pixels (n,) in which the subject may be, row-major; the rest is background.

    One ray per block of pixels decides; a margin of two blocks is added.
    """
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    rows, columns = -(-camera.height // _BLOCK_PX), -(-camera.width // _BLOCK_PX)
    lens = Lens(stage, camera)
    begin, end = shutter.span(camera.height)
    found = np.zeros((rows, columns), dtype=bool)
    index = dr.arange(mi.UInt32, rows * columns)
    wide = dr.opaque(mi.UInt32, columns)
    x = mi.Float(index % wide) * _BLOCK_PX + (_BLOCK_PX - 1) / 2
    y = mi.Float(index // wide) * _BLOCK_PX + (_BLOCK_PX - 1) / 2
    for time in {begin, end} if stage.rigid and stage.velocity_m_s.any() else {shutter.time_s}:
        shift = mi.Vector3f(*(number(v) for v in stage.shift(time)))
        rays = lens.rays(x, y, shift)
        hit = stage.scene.ray_test(mi.Ray3f(rays.origin, rays.way), coherent=True)
        found |= np.array(hit).reshape(rows, columns)
    margin = cv2.dilate(found.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    pixels = margin.repeat(_BLOCK_PX, 0).repeat(_BLOCK_PX, 1)
    return np.flatnonzero(pixels[: camera.height, : camera.width].ravel()).astype(np.uint32)


@dataclass(frozen=True)
class Sampling:
    """How pixels are sampled.

    Attributes
    ----------
    spp : int
        Sub-samples, a square number: strata over the pixel and over the exposure, paired anew in
        every pixel.
    key : int
        Of the jitter.
    window : tuple of float
        Only sub-samples whose time, seconds, lies in it; for scenes that are posed several times
        in an exposure.
    """

    spp: int
    key: int
    window: tuple[float, float] = (-1e9, 1e9)

    def __post_init__(self) -> None:
        """Refuse what cannot be laid out as a square."""
        if self.spp < 1 or isqrt(self.spp) ** 2 != self.spp:
            raise ConfigError(f"spp = {self.spp}; allowed are square numbers: 1, 4, 9, 16, ...")


def integrate(
    stage: Stage, camera: Camera, pixels: NDArray[np.uint32], shutter: Shutter,
    sampling: Sampling, look: Look, channels: int = 1,
) -> NDArray[np.float32]:  # fmt: skip
    """Sum what sub-samples of pixels see.

    Parameters
    ----------
    stage : Stage
        Posed.
    camera : Camera
        A true one.
    pixels : (n,) uint32
        Row-major raw pixels.
    shutter : Shutter
    sampling : Sampling
    look : callable
        From rays, the scene's shift and the active lanes to ``channels`` numbers.

    Returns
    -------
    (n, channels) float32
        To be divided by ``spp`` once all windows are summed.
    """
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    if not len(pixels):
        return np.zeros((0, channels), dtype=np.float32)
    lens = Lens(stage, camera)
    index = mi.UInt32(pixels)
    wide = dr.opaque(mi.UInt32, camera.width)
    column, row = mi.Float(index % wide), mi.Float(index // wide)
    side = dr.opaque(mi.UInt32, isqrt(sampling.spp))
    count = dr.opaque(mi.UInt32, sampling.spp)
    salt = dr.opaque(mi.UInt32, sampling.key & 0xFFFFFFFF)
    late = (row - number((camera.height - 1) / 2)) * number(shutter.line_delay_s)
    opening, exposure = number(shutter.time_s), number(shutter.exposure_s)
    begin, end = (number(edge) for edge in sampling.window)
    velocity = mi.Vector3f(*(number(v) for v in stage.velocity_m_s))
    posed = number(stage.posed_s)

    def sample(i: Any, *totals: Any) -> tuple[Any, ...]:
        a, b = mi.sample_tea_32(index ^ salt, i)
        turn, _ = mi.sample_tea_32(index ^ salt, count)
        x = column - 0.5 + (mi.Float(i % side) + share_of(a)) / mi.Float(side)
        y = row - 0.5 + (mi.Float(i // side) + share_of(b)) / mi.Float(side)
        stratum = mi.Float((i + turn) % count) + mi.Float(((a & 0xFF) << 8) | (b & 0xFF)) / 65536
        time = opening + late + (stratum / mi.Float(count) - 0.5) * exposure
        now = (time >= begin) & (time < end)
        shift = velocity * (time - posed)
        found = look(lens.rays(x, y, shift), shift, now)
        return i + 1, *(t + dr.select(now, f, 0) for t, f in zip(totals, found, strict=True))

    zero = tuple(dr.zeros(mi.Float, len(pixels)) for _ in range(channels))
    first = dr.zeros(mi.UInt32, len(pixels))
    _, *totals = dr.while_loop((first, *zero), lambda i, *_: i < count, sample, label="samples")
    dr.eval(totals)
    return np.stack([np.array(total) for total in totals], axis=1)


@dataclass(frozen=True, eq=False)
class Meeting:
    """Where rays meet the scene from outside, per lane.

    Attributes
    ----------
    hit : PreliminaryIntersection
    there, front : Bool
        Something was met; from outside.
    point : Point3f
    flat : Vector3f
        Normal of the face.
    corner : Vector4u
        Its drawn vertices, and the solid.
    weights : tuple of Float
        Of the corners.
    """

    hit: Any
    there: Any
    front: Any
    point: Any
    flat: Any
    corner: Any
    weights: tuple[Any, Any, Any]

    def mixed(self, quads: Any) -> Any:
        """Interpolate quadruples that are kept at the drawn vertices."""
        mi, dr = backend.mitsuba(), backend.drjit()
        ends = (self.corner.x, self.corner.y, self.corner.z)
        a, b, c = (dr.gather(mi.Vector4f, quads, end, self.front) for end in ends)
        u, v, w = self.weights
        return a * u + b * v + c * w


def meet(stage: Stage, rays: Rays, active: Any) -> Meeting:
    """Find what rays meet first."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    ray = mi.Ray3f(rays.origin, rays.way)
    hit = stage.scene.ray_intersect_preliminary(ray, coherent=True, active=active)
    there = active & hit.is_valid()
    flat = dr.gather(mi.Vector4f, stage.face_normals, hit.prim_index, there)
    flat = mi.Vector3f(flat.x, flat.y, flat.z)
    front = there & (dr.dot(flat, rays.way) < 0)
    corner = dr.gather(mi.Vector4u, stage.corners, hit.prim_index, front)
    u, v = hit.prim_uv.x, hit.prim_uv.y
    return Meeting(hit, there, front, ray(hit.t), flat, corner, (1 - u - v, u, v))


def speckle_look(stage: Stage, soft: SoftLight) -> Look:
    """Return how a grey camera sees the scene; back faces, which only holes show, are black."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    background = number(stage.rig.light.background)

    def look(rays: Rays, shift: Any, active: Any) -> tuple[Any]:
        met = meet(stage, rays, active)
        mixed = met.mixed(soft.vertices)
        normal = dr.normalize(mi.Normal3f(mixed.x, mixed.y, mixed.z))
        surface = dr.gather(mi.Vector4f, stage.surfaces, met.corner.w, met.front)
        reach = dr.gather(mi.UInt64, soft.reach, met.hit.prim_index, met.front)
        sure = dr.gather(mi.UInt64, soft.sure, met.hit.prim_index, met.front)
        direct, glint, _ = irradiance(
            stage.scene, stage.table, met.point, normal, met.flat * LIFT_M, shift, reach,
            reach & ~sure, Gloss(-rays.way, surface.z, surface.w),
        )  # fmt: skip
        light = surface.x * (dr.fma(-surface.y, direct, direct) + mixed.w) + glint
        behind = dr.select(met.there, 0, background)
        return (dr.select(met.front, light * rays.passed, behind),)

    return look
