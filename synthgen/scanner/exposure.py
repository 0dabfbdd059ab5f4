"""What a unit's cameras record of a scene under speckle, in counts.

>>> stage = prepare(scene, rig, rng=rng)      # once per scan  # doctest: +SKIP
>>> shot = expose(stage, rig.units[0])        # any unit, in any order  # doctest: +SKIP

All randomness of a scan hangs on one key that ``prepare`` draws; every unit and camera has its own
stream under it, so that the order of exposures does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, project
from synthgen.sampling.streams import stream
from synthgen.scanner.camera import (
    Look,
    Rays,
    Sampling,
    Shutter,
    integrate,
    region,
    shutter_of,
    speckle_look,
)
from synthgen.scanner.light import number
from synthgen.scanner.rig import Rig, Role, Sensor, Unit
from synthgen.scanner.sensor import Image, automatic_gain, counts, fixed_pattern, optical
from synthgen.scanner.softlight import SoftLight, soft_light
from synthgen.scanner.stage import Stage

SPP = 4
ROLES: tuple[Role, Role, Role] = ("left", "right", "colour")
# Poses per exposure of solids that do not move as one.
_POSES = 4
# Below this share of the ambient light there is no speckle to speak of.
_BLACK = 0.02
# From this share of saturated pixels on no pattern is left.
_WHITE = 0.9


@dataclass(frozen=True, eq=False)
class Exposure:
    """Pictures of one unit.

    Attributes
    ----------
    unit : Unit
    left, right : (H, W) uint8 or uint16
        Raw counts (distorted, not rectified), ``rig.grey.bits`` deep.
    time_s : float
        Middle of the exposure against the reference (unsynchronised units, slots).
    gain : float
        Full wells per unit of radiance that were used.
    problem : str or None
        Why the pictures are of no use (black speckle, nothing in view), naming the unit.
    """

    unit: Unit
    left: NDArray[Any]
    right: NDArray[Any]
    time_s: float
    gain: float
    problem: str | None


def unit_time(stage: Stage, unit: Unit) -> float:
    """Return when a unit exposes: its slot, and by how much it misses it in this scan."""
    rng = stream(stage.key, "sample", unit.index, 0, "sync")
    late = rng.uniform(-1.0, 1.0) * stage.rig.sync_s
    return unit.slot * stage.rig.slot_s + float(late)


def expose(stage: Stage, unit: Unit, *, spp: int = SPP) -> Exposure:
    """Take the speckle pictures of one unit.

    Parameters
    ----------
    stage : Stage
        Of :func:`synthgen.scanner.stage.prepare`.
    unit : Unit
        Of the stage's rig.
    spp : int
        Sub-samples per pixel, a square number. Fewer than 4 make noise of their own.

    Returns
    -------
    Exposure
        With ``problem`` set where the pictures are of no use.
    """
    time = unit_time(stage, unit)
    sensor = stage.rig.grey
    seen = [
        optical(speckle_radiance(stage, unit, role, spp=spp), sensor, unit.true.camera(role))
        for role in ROLES[:2]
    ]
    gain = sensor.gain or automatic_gain(seen, stage.rig.light.background, sensor.auto_target)
    left, right = (
        digitised(stage, unit, role, picture, sensor, gain or 1.0)
        for picture, role in zip(seen, ROLES[:2], strict=True)
    )
    problem = _problem(stage, unit, time, seen, left, sensor)
    return Exposure(unit, left, right, time, gain or 1.0, problem)


def digitised(
    stage: Stage, unit: Unit, role: Role, picture: Image, sensor: Sensor, gain: float,
    stream_name: str = "sensor",
) -> NDArray[Any]:  # fmt: skip
    """Return counts of one camera with its own fixed pattern and noise stream."""
    camera = 3 * unit.index + ROLES.index(role)
    fixed = fixed_pattern(stage.rig.seed, camera, *picture.shape, sensor.prnu, sensor.hot_share)
    rng = stream(stage.key, "sample", camera, 0, stream_name)
    return counts(picture, sensor, gain, fixed, rng=rng)


def speckle_radiance(stage: Stage, unit: Unit, role: Role, *, spp: int = SPP) -> Image:
    """Return the radiance (H, W) float32 that a unit's grey camera integrates, without a sensor."""
    shutter = shutter_of(stage.rig.grey, unit_time(stage, unit))
    background = (stage.rig.light.background,)

    def look() -> Look:
        return speckle_look(stage, _soft(stage, unit.slot, _light_time(stage, shutter)))

    return integrated(stage, unit, role, shutter, spp, look, background)[..., 0]


def integrated(
    stage: Stage, unit: Unit, role: Role, shutter: Shutter, spp: int,
    look: Callable[[], Look], background: tuple[float, ...],
) -> Image:  # fmt: skip
    """Return what a camera integrates, (H, W, C) float32, posing the scene as often as it needs.

    ``look`` is asked for anew after every pose.
    """
    camera = unit.true.camera(role)
    camera_number = 3 * unit.index + ROLES.index(role)
    key = int(stream(stage.key, "sample", camera_number, 0, "jitter").integers(2**32))
    picture = np.tile(np.array(background, np.float32), (camera.height * camera.width, 1))
    for time, window in _poses(stage, camera, shutter):
        stage.pose(time)
        pixels, sampling = region(stage, camera, shutter), Sampling(spp, key, window)
        # What is gained over the background, so that pixels left out have none of it.
        over = _above(look(), background)
        seen = integrate(stage, camera, pixels, shutter, sampling, over, len(background))
        picture[pixels] += seen / np.float32(spp)
    return picture.reshape(camera.height, camera.width, len(background))


def _poses(
    stage: Stage, camera: Camera, shutter: Shutter
) -> list[tuple[float, tuple[float, float]]]:
    """Return at which times the scene is posed for an exposure, and for which part of it."""
    if stage.rigid:
        return [(shutter.time_s, (-1e9, 1e9))]
    begin, end = shutter.span(camera.height)
    count = max(_POSES, round(_POSES * (end - begin) / shutter.exposure_s))
    edges = np.linspace(begin, end, count + 1).tolist()
    return [((low + high) / 2, (low, high)) for low, high in pairwise(edges)]


def _above(look: Look, background: tuple[float, ...]) -> Look:
    levels = [number(level) for level in background]

    def above(rays: Rays, shift: Any, active: Any) -> tuple[Any, ...]:
        found = look(rays, shift, active)
        return tuple(value - level for value, level in zip(found, levels, strict=True))

    return above


def _light_time(stage: Stage, shutter: Shutter) -> float:
    return shutter.time_s if stage.rigid else stage.posed_s


def _soft(stage: Stage, slot: int, time_s: float) -> SoftLight:
    """Return the light at the vertices, made again only where the scene has moved since.

    It is that of the nearest of some fixed times, so that the order of exposures does not matter.
    """
    speed = float(np.linalg.norm(stage.velocity_m_s))
    dot = min(p.pattern.dot_px * p.focus_m / p.optics.fx for p in stage.rig.projectors)
    step = 0.5 * dot / speed if speed else np.inf
    when = float(round(time_s / step)) * step if speed else 0.0
    kept = stage.kept.get(slot)
    if kept is None or kept[:2] != (stage.posed_s, when):
        kept = stage.posed_s, when, soft_light(stage, slot, when)
        stage.kept[slot] = kept
    light: SoftLight = kept[2]
    return light


def _problem(
    stage: Stage, unit: Unit, time_s: float, seen: list[Image], left: NDArray[Any], sensor: Sensor
) -> str | None:
    unseen = [
        role
        for picture, role in zip(seen, ROLES[:2], strict=True)
        if picture.max() <= 1.5 * stage.rig.light.background
    ]
    if not unseen:
        return _dark(stage, unit, time_s) or _misexposed(unit, left, sensor)
    if not _in_view(stage, unit.true.camera(unseen[0])).any():
        what = (
            "nothing of the subject; move the subject into the working volume or aim the unit at it"
        )
    else:
        what = (
            "only what is dark (its albedo, or out of all light) or smaller than a few pixels, or "
            "faces from behind: they must run counter-clockwise seen from outside"
        )
    told = f"unit {unit.ident}: its {unseen[0]} camera sees {what}"
    return unlit(stage.rig, unit, stage.rig.light.background) or told


def _in_view(stage: Stage, camera: Camera) -> NDArray[np.bool_]:
    """Return which drawn vertices (V,) lie in a camera's frame, hidden ones included."""
    pixels, z = project(camera, stage.vertices)
    size = np.array([camera.width, camera.height])
    return np.asarray((z > 0) & ((pixels >= 0) & (pixels < size)).all(axis=1))


def _dark(stage: Stage, unit: Unit, time_s: float) -> str | None:
    """Tell black speckle: projectors that give nothing against the ambient light."""
    camera = unit.true.left
    facing = np.einsum("vk,vk->v", stage.normals, camera.position - stage.vertices) > 0
    light = _soft(stage, unit.slot, time_s).irradiance[facing & _in_view(stage, camera)]
    ambient = stage.rig.light.ambient
    strongest = float(np.quantile(light, 0.95)) if len(light) else 0.0
    if strongest > max(_BLACK * ambient, 1e-9):
        return None
    return _black(stage.rig, unit, strongest)


def unlit(rig: Rig, unit: Unit, least: float = 0.0) -> str | None:
    """Tell projectors that give nothing against the ambient light wherever they shine.

    What there is to know without a picture; :func:`expose` tells more. Irradiance that is not above
    ``least`` is nothing, too.
    """
    strongest = sum(projector.irradiance for projector in rig.lit_by(unit))
    if strongest > max(_BLACK * rig.light.ambient, least):
        return None
    return _black(rig, unit, strongest)


def _black(rig: Rig, unit: Unit, strongest: float) -> str:
    names = [p.ident for p in rig.lit_by(unit)]
    shown = ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")
    shown = shown or f"(none in its slot {unit.slot})"
    return (
        f"unit {unit.ident}: black speckle: projectors {shown} give "
        f"{strongest:.2g} of irradiance against {rig.light.ambient:g} of ambient light on what its "
        "left camera sees; raise projector.irradiance (what arrives at the focus distance) or aim "
        "them"
    )


def _misexposed(unit: Unit, left: NDArray[Any], sensor: Sensor) -> str | None:
    black = sensor.black_dn * sensor.full_scale / 255
    bright = float(np.quantile(left, 0.999)) - black
    if bright * 255 / sensor.full_scale <= 6:
        return (
            f"unit {unit.ident}: the picture is black, {bright:.1f} counts above the black level "
            f"of {sensor.bits} bits; raise grey_sensor.gain, or leave it null for automatic "
            "exposure"
        )
    lit = left[left > black + 6 * sensor.full_scale / 255]
    white = float((lit >= 0.97 * sensor.full_scale).mean()) if len(lit) else 0.0
    if white < _WHITE or not sensor.saturation:
        return None
    return (
        f"unit {unit.ident}: the picture is overexposed, {100 * white:.0f} % of what is lit is at "
        "full scale; lower grey_sensor.gain, or leave it null for automatic exposure"
    )
