"""Colour pictures under white panels.

White light is smooth, so all of it is kept at the drawn vertices (direct with soft shadows, one
bounce in colour, surround), and a picture costs one ray per sub-sample. Only gloss is made per ray.
Every pixel has all three colours: there is no Bayer pattern.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.transforms import look_at
from synthgen.render import backend
from synthgen.render.sensor import LUMINANCE, encode_srgb
from synthgen.scanner.camera import Look, Rays, meet, shutter_of
from synthgen.scanner.exposure import SPP, digitised, integrated, unit_time
from synthgen.scanner.light import F0, LIFT_M, number
from synthgen.scanner.mesh import Part
from synthgen.scanner.rig import Unit
from synthgen.scanner.sensor import optical
from synthgen.scanner.softlight import bounce
from synthgen.scanner.stage import Stage

Array = NDArray[np.float64]

# Shadow rays per vertex and panel.
_PANEL_RAYS = 8
# Even light that fills the room, against the panels' sum at the origin.
_SURROUND = 0.1


@dataclass(frozen=True, eq=False)
class WhiteLight:
    """White light at the drawn vertices, as quadruples on the device.

    Attributes
    ----------
    normals : Float
        Normal, and the share of the panels' light that arrives.
    radiance : Float
        Red, green, blue of the diffuse reflection.
    panels : (n, 3) float64
        Centres of the panels, and what each gives a facing surface at the origin: ``power``.
    power : float
    """

    normals: Any
    radiance: Any
    panels: Array
    power: float


def expose_colour(stage: Stage, unit: Unit, *, spp: int = SPP) -> NDArray[np.uint8]:
    """Take the colour picture of one unit.

    Parameters
    ----------
    stage : Stage
    unit : Unit
        With a colour camera.
    spp : int
        Sub-samples per pixel, a square number.

    Returns
    -------
    (H, W, 3) uint8
        sRGB, raw geometry of the colour camera, black behind the subject; exposed so that the
        99 % quantile of the subject's luminance is at ``auto_target`` of full scale, or by the
        sensor's own gain.
    """
    rig, sensor = stage.rig, stage.rig.colour
    camera = unit.true.camera("colour")
    time = unit_time(stage, unit) + rig.light.white_delay_s
    shutter = shutter_of(sensor, time)

    def look() -> Look:
        return _look(stage, _kept(stage))

    linear = integrated(stage, unit, "colour", shutter, spp, look, (0.0, 0.0, 0.0))
    channels = [optical(linear[..., c], sensor, camera) for c in range(3)]
    gain = sensor.gain or _automatic(channels, sensor.auto_target)
    full, black = sensor.full_scale, sensor.black_dn * sensor.full_scale / 255
    raw = [
        digitised(stage, unit, "colour", channel, sensor, gain, stream_name=f"sensor {c}")
        for c, channel in enumerate(channels)
    ]
    return encode_srgb((np.stack(raw, axis=-1).astype(np.float32) - black) / (full - black))


def _automatic(channels: list[NDArray[np.float32]], target: float) -> float:
    luminance = sum(float(w) * c for w, c in zip(LUMINANCE, channels, strict=True))
    bright = np.asarray(luminance)[np.asarray(luminance) > 1e-6]
    return target / float(np.quantile(bright, 0.99)) if len(bright) else 1.0


def _kept(stage: Stage) -> WhiteLight:
    """Return the white light; a shift of the whole scene by millimetres does not change it."""
    if "white" not in stage.kept or stage.kept["white"][0] != stage.posed_s:
        when = stage.rig.light.white_delay_s if stage.rigid else stage.posed_s
        stage.kept["white"] = stage.posed_s, white_light(stage, when)
    light: WhiteLight = stage.kept["white"][1]
    return light


def white_light(stage: Stage, time_s: float) -> WhiteLight:
    """Find the white light at the vertices of the scene as it is posed."""
    mi: Any = backend.mitsuba()
    light = stage.rig.light
    panels = np.array(light.white, dtype=np.float64).reshape(-1, 3)
    # Together they give a facing surface at the origin an irradiance of 1 where none is in shadow.
    power = 1.0 / max(float((1 / (panels**2).sum(axis=1)).sum()), 1e-12) if len(panels) else 0.0
    arriving, unblocked = _panels(stage, panels, power, stage.shift(time_s))
    albedo = np.concatenate([_albedo(part) for part in stage.mesh.parts])
    surround = _SURROUND if len(panels) else 1.0
    direct = arriving[:, None] + surround
    thrown, open_ = bounce(stage, albedo * direct)
    radiance = albedo * (arriving[:, None] + thrown + surround * open_[:, None])
    share = arriving / np.maximum(unblocked, 1e-9)
    none = np.zeros(len(radiance))
    return WhiteLight(
        normals=mi.Float(np.column_stack([stage.normals, share]).astype(np.float32).ravel()),
        radiance=mi.Float(np.column_stack([radiance, none]).astype(np.float32).ravel()),
        panels=panels,
        power=power,
    )


def _albedo(part: Part) -> Array:
    """Return linear reflectance (V, 3) at the drawn vertices of one solid."""
    solid = part.solid
    if solid.colours is None:
        return np.tile(np.array(solid.surface.rgb), (len(part.source), 1))
    return part.spread(np.asarray(solid.colours, np.float64))[part.source]


def _panels(stage: Stage, panels: Array, power: float, shift: Array) -> tuple[Array, Array]:
    """Irradiance of the panels at the drawn vertices, with shadows and without, (V,) each."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    n = len(stage.vertices)
    if not len(panels):
        return np.zeros(n), np.zeros(n)
    points = mi.Point3f(stage.vertices.T.astype(np.float32))
    normals = mi.Normal3f(stage.normals.T.astype(np.float32))
    half = stage.rig.light.white_size_m / 2
    frames = np.array([_frame(centre) for centre in panels])
    table = mi.Float(np.concatenate([frames[:, :3, :2] * half, frames[:, :3, 2:]], axis=2)
                     .transpose(0, 2, 1).astype(np.float32).ravel())  # fmt: skip
    count = dr.opaque(mi.UInt32, len(panels) * _PANEL_RAYS)
    moved, strength = mi.Vector3f(*(number(v) for v in shift)), number(power / _PANEL_RAYS)

    def shoot(i: Any, lit: Any, free: Any) -> tuple[Any, Any, Any]:
        panel = i // _PANEL_RAYS
        right, up, front, centre = (
            dr.gather(mi.Vector3f, table, panel * 4 + row) for row in range(4)
        )
        # The same points for every vertex: shadows have faint steps, but no noise.
        u = _spread(mi.Float(i), 0.7548776662466927)
        v = _spread(mi.Float(i), 0.5698402909980532)
        way = centre + right * u + up * v - (points + moved)
        r2 = dr.squared_norm(way)
        way = way * dr.rsqrt(r2)
        light = dr.maximum(dr.dot(normals, way), 0) * dr.maximum(-dr.dot(front, way), 0) / r2
        ray = mi.Ray3f(points + normals * LIFT_M, way)
        ray.maxt = dr.sqrt(r2) * 0.999
        blocked = stage.scene.ray_test(ray, active=light > 0)
        return i + 1, lit + dr.select(blocked, 0, light * strength), free + light * strength

    zero = dr.zeros(mi.Float, n), dr.zeros(mi.Float, n)
    first = dr.zeros(mi.UInt32, n)
    _, lit, free = dr.while_loop((first, *zero), lambda i, *_: i < count, shoot, label="panels")
    dr.eval(lit, free)
    return np.array(lit, dtype=np.float64), np.array(free, dtype=np.float64)


def _spread(i: Any, step: float) -> Any:
    """Return the i-th point of a sequence that fills (-1, 1) evenly."""
    x = (i + 0.5) * step
    return 2 * (x - backend.drjit().floor(x)) - 1


def _frame(centre: Array) -> Array:
    """Pose of a panel that faces the origin."""
    steep = abs(centre[1]) > 0.99 * np.linalg.norm(centre)
    return look_at(centre, np.zeros(3), (0.0, 0.0, 1.0) if steep else (0.0, 1.0, 0.0))


def _look(stage: Stage, white: WhiteLight) -> Look:
    """Return how a colour camera sees the scene."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    # An even surround without panels has no glint, but the loop still needs something to read.
    centres = mi.Float(
        (white.panels if len(white.panels) else np.ones((1, 3))).astype(np.float32).ravel()
    )
    count, power = dr.opaque(mi.UInt32, len(white.panels)), number(white.power)

    def look(rays: Rays, shift: Any, active: Any) -> tuple[Any, ...]:
        met = meet(stage, rays, active)
        mixed, colour = met.mixed(white.normals), met.mixed(white.radiance)
        normal = dr.normalize(mi.Normal3f(mixed.x, mixed.y, mixed.z))
        surface = dr.gather(mi.Vector4f, stage.surfaces, met.corner.w, met.front)

        def glint(i: Any, total: Any) -> tuple[Any, Any]:
            way = dr.gather(mi.Point3f, centres, i) - (met.point + shift)
            r2 = dr.squared_norm(way)
            way = mi.Vector3f(way) * dr.rsqrt(r2)
            lobe = _lobe(normal, -rays.way, way, surface.w)
            return i + 1, total + dr.select(met.front, lobe / r2 * power, 0)

        state = dr.zeros(mi.UInt32, dr.width(mixed.w)), dr.zeros(mi.Float, dr.width(mixed.w))
        _, gloss = dr.while_loop(state, lambda i, _: i < count, glint, label="glints")
        gloss = gloss * surface.z * mixed.w
        return tuple(
            dr.select(met.front, (c + gloss) * rays.passed, 0)
            for c in (colour.x, colour.y, colour.z)
        )

    return look


def _lobe(normal: Any, view: Any, way: Any, alpha: Any) -> Any:
    """Blinn's half vector in a GGX shape, widened by the panel's size; radiance per power."""
    dr: Any = backend.drjit()
    half = dr.normalize(way + view)
    nh = dr.maximum(dr.dot(normal, half), 0)
    nl = dr.maximum(dr.dot(normal, way), 0)
    a2 = alpha * alpha + 0.02
    base = nh * nh * (a2 - 1) + 1
    return F0 * a2 / (4 * base * base) * dr.select(nl > 0, 1, 0)
