"""Speckle light on the device: one table of all projectors, walked bit by bit in one kernel.

Numbers reach the kernel as data, never as literals, so that one compiled kernel serves every
camera, projector and scan. A point's projectors come as the bits of a word: a lane visits only
those that may reach it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from synthgen.render import backend
from synthgen.scanner.glass import normal_shift, thickness_for, transmittance
from synthgen.scanner.pattern import LEVELS, packed_pyramid
from synthgen.scanner.rig import Pattern, Projector, Rig

_STRIDE = 6  # quadruples of numbers per projector
# Shadow rays start this far off the surface, metres.
LIFT_M = 2e-5
# Fresnel reflectance of skin and most plastics, head on.
F0 = 0.04


@dataclass(frozen=True, eq=False)
class ProjectorTable:
    """All projectors of a rig as device arrays.

    Attributes
    ----------
    numbers : Float
        ``_STRIDE`` quadruples each: centre and focal length; x axis and principal point; y axis and
        1 / focus; z axis and power; defocus, vignetting, glass, size; first row of ``levels``.
    slides : UInt32
        Packed texels of every level of every slide.
    levels : UInt32
        Per slide and level: first texel, edge.
    ior : Float or None
        Of the glass; None without, which makes a simpler kernel.
    """

    numbers: Any
    slides: Any
    levels: Any
    ior: Any


def upload(rig: Rig) -> ProjectorTable:
    """Put the rig's projectors on the device."""
    mi: Any = backend.mitsuba()
    keys = [(p.pattern, p.optics.width) for p in rig.projectors]
    different = tuple(dict.fromkeys(keys))
    slides, levels = _slides_on_device(different)
    rows = [
        _numbers(p, LEVELS * different.index(key), thickness_for(rig.glass, p.optics.position))
        for p, key in zip(rig.projectors, keys, strict=True)
    ]
    return ProjectorTable(
        numbers=mi.Float(np.array(rows, dtype=np.float32).ravel()),
        slides=slides,
        levels=levels,
        ior=None if rig.glass is None else number(rig.glass.ior),
    )


@lru_cache(maxsize=4)
def _slides_on_device(keys: tuple[tuple[Pattern, int], ...]) -> tuple[Any, Any]:
    """Make slides once per process: all texels in a row, and first texel and edge per level."""
    mi: Any = backend.mitsuba()
    texels = [level for pattern, size in keys for level in packed_pyramid(pattern, size)]
    starts = np.cumsum([0, *(len(level) for level in texels)])[:-1]
    edges = [round(len(level) ** 0.5) for level in texels]
    levels = np.column_stack([starts, edges]).astype(np.uint32)
    return mi.UInt32(np.concatenate(texels)), mi.UInt32(levels.ravel())


def number(value: float) -> Any:
    """Pass a number as data: a literal would be compiled into the kernel."""
    return backend.drjit().opaque(backend.mitsuba().Float, float(value))


def _numbers(projector: Projector, first_level: int, thickness: float) -> list[float]:
    optics = projector.optics
    x, y, z = optics.T[:3, :3].T
    spread = projector.aperture_m * optics.fx / 4  # sigma of a disc is a quarter of its diameter
    power = projector.irradiance * projector.focus_m**2
    return [
        *optics.position, optics.fx,
        *x, optics.cx,
        *y, 1 / projector.focus_m,
        *z, power,
        spread, projector.vignetting, thickness, optics.width,
        first_level, optics.cy, 0, 0,
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Gloss:
    """What a specular lobe needs: direction to the eye, weight and squared roughness, per lane."""

    view: Any
    weight: Any
    alpha: Any


def irradiance(
    scene: Any, table: ProjectorTable, point: Any, normal: Any, lift: Any, shift: Any,
    bits: Any, unsure: Any, gloss: Gloss | None = None,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Sum the light of projectors on surface points.

    Parameters
    ----------
    scene : mitsuba.Scene
    table : ProjectorTable
    point, normal : Point3f, Normal3f
        At the scene's pose; shading normal.
    lift : Vector3f
        From the point to the origin of its shadow rays.
    shift : Vector3f
        By how much the whole scene has moved since its pose.
    bits, unsure : UInt64
        Projectors that may reach the point, and those among them that need a shadow ray.
    gloss : Gloss or None

    Returns
    -------
    irradiance : Float
        Diffuse; a white Lambertian surface has radiance 1 under 1.
    specular : Float
        Radiance of the specular lobe; 0 without ``gloss``.
    lit : UInt64
        Projectors whose light, whatever their slide shows there, arrives.
    """
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()

    def visit(bits: Any, total: Any, glint: Any, lit: Any) -> tuple[Any, Any, Any, Any]:
        k = mi.UInt32(dr.tzcnt(bits))
        bit = mi.UInt64(1) << mi.UInt64(k)
        arriving, way, distance = _arriving(table, k, point + shift)
        cosine = dr.dot(normal, way)
        use = (arriving > 0) & (cosine > 0)
        ray = mi.Ray3f(mi.Point3f(point + lift), way)
        ray.maxt = distance * 0.999
        use &= ~scene.ray_test(ray, active=use & ((unsure & bit) != 0))
        pattern = _slide(table, k, point + shift, way, use)
        light = dr.select(use, arriving * cosine * pattern, 0)
        if gloss is not None:
            glint = glint + dr.select(use, light * _lobe(gloss, normal, way, cosine), 0)
        return bits & (bits - 1), total + light, glint, lit | dr.select(use, bit, 0)

    zero = dr.zeros(mi.Float, dr.width(bits))
    none = dr.zeros(mi.UInt64, dr.width(bits))
    _, total, glint, lit = dr.while_loop(
        (mi.UInt64(bits), zero, mi.Float(zero), none), lambda bits, *_: bits != 0, visit,
        label="projectors",
    )  # fmt: skip
    return total, glint, lit


def _row(table: ProjectorTable, k: Any, which: int) -> tuple[Any, Any, Any, Any]:
    mi, dr = backend.mitsuba(), backend.drjit()
    quad = dr.gather(mi.Vector4f, table.numbers, k * _STRIDE + which)
    return quad.x, quad.y, quad.z, quad.w


def _arriving(table: ProjectorTable, k: Any, where: Any) -> tuple[Any, Any, Any]:
    """Irradiance of a bright slide on a facing surface, direction to the light, distance."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    cx, cy, cz, focal = _row(table, k, 0)
    zx, zy, zz, power = _row(table, k, 3)
    _, vignetting, thickness, size = _row(table, k, 4)
    way = mi.Vector3f(cx, cy, cz) - where
    passed = mi.Float(1)
    if table.ior is not None:
        height = mi.Float(way.y)
        for _ in range(4):
            cosine = dr.abs(way.y) * dr.rsqrt(dr.squared_norm(way))
            shift = normal_shift(cosine, thickness, table.ior, dr.sqrt)
            way.y = height - dr.sign(height) * shift
        cosine = dr.abs(way.y) * dr.rsqrt(dr.squared_norm(way))
        passed = dr.select(thickness > 0, transmittance(cosine, table.ior, dr.sqrt), 1)
    r2 = dr.squared_norm(way)
    distance = dr.sqrt(r2)
    way = way / distance
    ahead = -(way.x * zx + way.y * zy + way.z * zz)
    x, y = _texel(table, k, way, ahead, focal)
    inside = (ahead > 0.01) & (x > 0) & (y > 0) & (x < size - 1) & (y < size - 1)
    falloff = dr.power(dr.maximum(ahead, 0.01), vignetting)
    return dr.select(inside, power / r2 * falloff * passed, 0), way, distance


def _texel(table: ProjectorTable, k: Any, way: Any, ahead: Any, focal: Any) -> tuple[Any, Any]:
    """Texel coordinates, integer centres, of a direction ``way`` towards the projector."""
    xx, xy, xz, cx = _row(table, k, 1)
    yx, yy, yz, _ = _row(table, k, 2)
    _, cy, _, _ = _row(table, k, 5)
    x = -(way.x * xx + way.y * xy + way.z * xz)
    y = -(way.x * yx + way.y * yy + way.z * yz)
    return focal * x / ahead + cx, focal * y / ahead + cy


def _slide(table: ProjectorTable, k: Any, where: Any, way: Any, use: Any) -> Any:
    """Read the slide between the two levels of its pyramid that enclose the blur there."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    cx, cy, cz, focal = _row(table, k, 0)
    zx, zy, zz, _ = _row(table, k, 3)
    _, _, _, sharp = _row(table, k, 2)
    spread, _, _, _ = _row(table, k, 4)
    first, _, _, _ = _row(table, k, 5)
    ahead = -(way.x * zx + way.y * zy + way.z * zz)
    x, y = _texel(table, k, way, ahead, focal)
    depth = (where.x - cx) * zx + (where.y - cy) * zy + (where.z - cz) * zz
    sigma = dr.minimum(spread * dr.abs(1 / depth - sharp), 2.0 ** (LEVELS - 1))
    below = dr.clip(mi.UInt32(dr.log2(dr.maximum(sigma, 1))), 0, LEVELS - 2)
    low = dr.select(below == 0, 0, mi.Float(mi.UInt32(1) << below))
    high = mi.Float(mi.UInt32(2) << below)
    share = (sigma * sigma - low * low) / (high * high - low * low)
    row = mi.UInt32(first) + below
    near = _read(table, row, below, x, y, use)
    far = _read(table, row + 1, below + 1, x, y, use & (share > 0))
    return dr.fma(share, far - near, near) / 255


def _read(table: ProjectorTable, row: Any, level: Any, x: Any, y: Any, use: Any) -> Any:
    """Interpolate one level bilinearly with a single read; 0..255."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    start = dr.gather(mi.UInt32, table.levels, 2 * row, use)
    size = dr.gather(mi.UInt32, table.levels, 2 * row + 1, use)
    scale = 1 / mi.Float(mi.UInt32(1) << level)
    u = dr.clip((x + 0.5) * scale - 0.5, 0, mi.Float(size) - 1.001)
    v = dr.clip((y + 0.5) * scale - 0.5, 0, mi.Float(size) - 1.001)
    column, line = mi.UInt32(u), mi.UInt32(v)
    u, v = u - mi.Float(column), v - mi.Float(line)
    word = dr.gather(mi.UInt32, table.slides, start + line * size + column, use)
    a, b, c, d = (mi.Float((word >> shift) & 0xFF) for shift in (0, 8, 16, 24))
    top, bottom = dr.fma(u, b - a, a), dr.fma(u, d - c, c)
    return dr.fma(v, bottom - top, top)


def _lobe(gloss: Gloss, normal: Any, way: Any, cosine: Any) -> Any:
    """GGX times pi over the cosine of the light: radiance per irradiance."""
    dr: Any = backend.drjit()
    half = dr.normalize(way + gloss.view)
    nh = dr.maximum(dr.dot(normal, half), 0)
    nv = dr.maximum(dr.dot(normal, gloss.view), 0.05)
    away = 1 - dr.clip(dr.dot(gloss.view, half), 0, 1)
    a2 = gloss.alpha * gloss.alpha
    base = nh * nh * (a2 - 1) + 1
    spread = a2 / (base * base)  # D times pi
    g_light = 2 * cosine / (cosine + dr.sqrt(a2 + (1 - a2) * cosine * cosine))
    g_view = 2 * nv / (nv + dr.sqrt(a2 + (1 - a2) * nv * nv))
    fresnel = F0 + (1 - F0) * away * dr.square(dr.square(away))
    return gloss.weight * spread * fresnel * g_light * g_view / (4 * nv * dr.maximum(cosine, 1e-3))
