"""Light that is kept at vertices: who is lit, what spreads below the skin, what is thrown back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from synthgen.geometry.normals import vertex_normals
from synthgen.render import backend
from synthgen.scanner.light import LIFT_M, irradiance, number
from synthgen.scanner.mesh import Part
from synthgen.scanner.stage import Stage

Array = NDArray[np.float64]

_BOUNCE_RAYS = 1_500_000
_SMOOTHING = 6


@dataclass(frozen=True, eq=False)
class SoftLight:
    """Light at the drawn vertices for one time slot and one time.

    Attributes
    ----------
    irradiance : (V,) float32
        Direct light of the projectors.
    vertices : Float
        Quadruples on the device: normal and soft irradiance (below the skin, thrown, ambient).
    reach, sure : UInt64
        Per face, projectors that may reach it, and those that reach all of it.
    """

    irradiance: NDArray[np.float32]
    vertices: Any
    reach: Any
    sure: Any


def soft_light(stage: Stage, slot: int, time_s: float) -> SoftLight:
    """Find the light at the vertices of the scene as it is posed."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    bits = slot_bits(stage, slot)
    points = mi.Point3f(stage.vertices.T.astype(np.float32))
    normals = mi.Normal3f(stage.normals.T.astype(np.float32))
    shift = mi.Vector3f(*(number(v) for v in stage.shift(time_s)))
    every = mi.UInt64(bits) | dr.zeros(mi.UInt64, len(stage.vertices))
    unsure = every if stage.effects.shadows else every & 0
    light, _, lit = irradiance(
        stage.scene, stage.table, points, normals, normals * LIFT_M, shift, every, unsure
    )
    dr.eval(light, lit)
    _note_useless(stage, slot, int(np.bitwise_or.reduce(np.array(lit))))
    direct = np.array(light)
    soft = _soft(stage, direct)
    quads = np.column_stack([stage.normals, soft]).astype(np.float32)
    reach, sure = _faces(stage, bits, lit)
    return SoftLight(direct, mi.Float(quads.ravel()), reach, sure)


def _note_useless(stage: Stage, slot: int, used: int) -> None:
    for k, projector in enumerate(stage.rig.projectors):
        note = f"projector {projector.ident} lights nothing of the subject"
        if projector.slot == slot and not used >> k & 1 and note not in stage.notes:
            stage.notes.append(note)


def slot_bits(stage: Stage, slot: int) -> Any:
    """Return the word whose bits are the projectors of a slot, as data."""
    word = sum(1 << k for k, p in enumerate(stage.rig.projectors) if p.slot == slot)
    return backend.drjit().opaque(backend.mitsuba().UInt64, word)


def _faces(stage: Stage, bits: Any, lit: Any) -> tuple[Any, Any]:
    """Per face: projectors that light some corner, and those that light all."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    n = len(stage.mesh.faces)
    if not stage.effects.vertex_cache:
        reach = mi.UInt64(bits) | dr.zeros(mi.UInt64, n)
        return reach, reach & 0 if stage.effects.shadows else reach
    corners = dr.gather(mi.Vector4u, stage.corners, dr.arange(mi.UInt32, n))
    a, b, c = (dr.gather(mi.UInt64, lit, corner) for corner in (corners.x, corners.y, corners.z))
    reach = dr.select(stage.coarse, bits, a | b | c)
    sure = dr.select(stage.coarse, 0, a & b & c)
    dr.eval(reach, sure)
    return reach, sure if stage.effects.shadows else reach


def _soft(stage: Stage, direct: NDArray[np.float32]) -> Array:
    ambient = stage.rig.light.ambient
    albedo = np.array([part.solid.surface.albedo for part in stage.mesh.parts])
    own = np.concatenate(
        [np.full(len(p.source), a) for p, a in zip(stage.mesh.parts, albedo, strict=True)]
    )
    if stage.effects.bounce:
        thrown, open_ = bounce(stage, (own * (direct + ambient))[:, None])
        soft = thrown[:, 0] + ambient * open_
    else:
        soft = np.full(len(direct), ambient, dtype=np.float64)
    for part, skin in zip(stage.mesh.parts, stage.skins, strict=True):
        if skin is not None:
            rows = slice(part.first_vertex, part.first_vertex + len(part.source))
            spread = skin.apply(_at_points(part, direct[rows]))
            soft[rows] += part.solid.surface.subsurface * spread[part.source]
    return soft


def _at_points(part: Part, values: NDArray[Any]) -> Array:
    """Average values at drawn vertices to the points they share."""
    if part.solid.normals is not None:
        return np.asarray(values, dtype=np.float64)
    n = len(part.points)
    total = np.bincount(part.source, values, n)
    return np.asarray(total / np.maximum(np.bincount(part.source, minlength=n), 1))


def bounce(stage: Stage, radiosity: Array) -> tuple[Array, Array]:
    """Gather light that one reflection throws onto the scene, by cosine-distributed rays.

    It is smooth, so it is found at the solids' own vertices and interpolated.

    Parameters
    ----------
    stage : Stage
    radiosity : (V, C) float
        Reflectance times irradiance at the drawn vertices.

    Returns
    -------
    thrown : (V, C) float64
        Irradiance.
    open : (V,) float64
        Share of the hemisphere in which nothing stands.
    """
    mi: Any = backend.mitsuba()
    sources = [mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in radiosity.T]
    thrown, opened = [], []
    for part in stage.mesh.parts:
        own = part.solid.at(stage.posed_s)
        values = _gathered(stage, own, vertex_normals(own, part.solid.faces), sources)
        smooth = _neighbourhood(part.solid.faces, len(own))
        for _ in range(_SMOOTHING):
            values = smooth @ values
        drawn = part.spread(values)[part.source]
        thrown.append(drawn[:, :-1])
        opened.append(drawn[:, -1])
    return np.concatenate(thrown), np.concatenate(opened)


def _gathered(stage: Stage, points: Array, normals: Array, sources: list[Any]) -> Array:
    """Mean over rays of each source where they hit, and of those that hit nothing, (n, C + 1)."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    n = len(points)
    rays = int(np.clip(_BOUNCE_RAYS // n, 8, 64))
    index = dr.arange(mi.UInt32, n)
    p, normal = mi.Point3f(points.T.astype(np.float32)), mi.Normal3f(normals.T.astype(np.float32))
    frame = mi.Frame3f(normal)

    def shoot(i: Any, *sums: Any) -> tuple[Any, ...]:
        u, v = mi.sample_tea_32(index, i)
        way = frame.to_world(
            mi.warp.square_to_cosine_hemisphere(mi.Point2f(share_of(u), share_of(v)))
        )
        ray = mi.Ray3f(p + normal * LIFT_M, way)
        hit = stage.scene.ray_intersect_preliminary(ray)
        there = hit.is_valid()
        front = there & (dr.dot(_flat_normal(stage, hit.prim_index, there), way) < 0)
        found = at_hit(stage, hit, front, sources)
        missed = dr.select(there, 0.0, 1.0)
        return i + 1, *(s + f for s, f in zip(sums, [*found, missed], strict=True))

    zero = [dr.zeros(mi.Float, n) for _ in range(len(sources) + 1)]
    first = dr.zeros(mi.UInt32, n)
    count = dr.opaque(mi.UInt32, rays)
    _, *sums = dr.while_loop((first, *zero), lambda i, *_: i < count, shoot, label="bounce")
    dr.eval(sums)
    return np.stack([np.array(s, dtype=np.float64) for s in sums], axis=1) / rays


def at_hit(stage: Stage, hit: Any, active: Any, sources: list[Any]) -> list[Any]:
    """Interpolate values at drawn vertices where rays hit; 0 where not active."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    a, b, c = at_corners(stage, hit, active)
    u, v = hit.prim_uv.x, hit.prim_uv.y

    def value(source: Any) -> Any:
        x, y, z = (dr.gather(mi.Float, source, corner, active) for corner in (a, b, c))
        return dr.select(active, dr.fma(u, y - x, dr.fma(v, z - x, x)), 0)

    return [value(source) for source in sources]


def at_corners(stage: Stage, hit: Any, active: Any) -> tuple[Any, Any, Any]:
    """Return the drawn vertices of the triangles that rays hit."""
    mi: Any = backend.mitsuba()
    found = backend.drjit().gather(mi.Vector4u, stage.corners, hit.prim_index, active)
    return found.x, found.y, found.z


def _flat_normal(stage: Stage, prim: Any, active: Any) -> Any:
    mi: Any = backend.mitsuba()
    quad = backend.drjit().gather(mi.Vector4f, stage.face_normals, prim, active)
    return mi.Vector3f(quad.x, quad.y, quad.z)


def share_of(word: Any) -> Any:
    """Return a number in [0, 1) made of a word's upper 24 bits."""
    return backend.mitsuba().Float(word >> 8) * (2.0**-24)


def _neighbourhood(faces: NDArray[np.int64], n: int) -> sparse.csr_matrix:
    """Return the (n, n) matrix that averages every vertex with its neighbours."""
    half = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    i, j = half.T
    ones = np.ones(2 * len(half))
    ring = sparse.csr_matrix((ones, (np.r_[i, j], np.r_[j, i])), (n, n))
    ring = ring + sparse.identity(n)
    ring.data[:] = 1.0
    return sparse.csr_matrix(sparse.diags(1 / np.asarray(ring.sum(axis=1)).ravel()) @ ring)
