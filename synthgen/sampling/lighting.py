"""Lights: an even surround, lamps, the lamps and windows of a room, sun and sky, panoramas.

Irradiance is in the units in which a white constant surround of radiance 1 gives pi; it is about 2
to 4 at the subject, whatever the kind, so that light and exposure stay in proportion. Lamps keep to
the camera's side of the hand: a foreground that is darker than its background is what betrays a
composed picture first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.sampling.appearance import rounded
from synthgen.scene import AreaLight, Background, Lights, Picture, Sky
from synthgen.scene.description import Vec3

Array = NDArray[np.float64]

# Relative red, green, blue of common light: tungsten, warm and neutral LED, daylight.
_WHITES = np.array([[1.0, 0.74, 0.48], [1.0, 0.86, 0.68], [1.0, 0.96, 0.9], [0.92, 0.97, 1.06]])
_DAYLIGHT = np.array([0.9, 0.97, 1.08])
# A lamp's middle keeps so far from a room's walls: half the diagonal of the largest.
_OFF_WALL_M = 0.18


def sample_lights(
    kind: str,
    subject: Array,
    camera: Array,
    background: Background,
    *,
    rng: np.random.Generator,
    panorama: Picture | None = None,
) -> Lights:
    """Draw the lights of one sample.

    Parameters
    ----------
    kind : {"constant", "area", "room", "lamp", "sky", "hdri"}
    subject, camera : (3,)
        World positions, metres.
    background : Background
        A room's walls hold its window and its ceiling lamp.
    rng : numpy.random.Generator
    panorama : Picture or None
        The file of kind ``hdri``.
    """
    if kind == "constant":
        return Lights(constant_rgb=_tint(rng.uniform(0.6, 1.0), rng))
    if kind == "area":
        lamp = _lamp(subject, camera, rng.uniform(1.5, 4.0), (0.15, 0.5), rng=rng)
        return Lights(constant_rgb=_tint(rng.uniform(0.25, 0.6), rng), area=(lamp,))
    if kind == "lamp":
        room = background if background.kind == "room" else None
        lamp = _lamp(subject, camera, rng.uniform(2.5, 4.0), (0.06, 0.25), rng=rng, room=room)
        dim = _tint(rng.uniform(0.03, 0.12), rng)
        return Lights(dim if room is None else (0.0, 0.0, 0.0), area=(lamp,))
    if kind in ("sky", "hdri"):
        return Lights((0.0, 0.0, 0.0), sky=_sky(subject, camera, panorama, rng))
    if background.kind == "room":
        return Lights((0.0, 0.0, 0.0), area=_room_lamps(subject, camera, background, rng))
    lamps = tuple(_near_ceiling(subject, camera, share, rng=rng) for share in (2.4, 1.0))
    return Lights(constant_rgb=_tint(rng.uniform(0.08, 0.2), rng), area=lamps)


def _lamp(
    subject: Array, camera: Array, irradiance: float, size_m: tuple[float, float],
    *, rng: np.random.Generator, room: Background | None = None,
) -> AreaLight:  # fmt: skip
    """One lamp on the camera's side of the subject, never below it by much, within a room."""
    camera_m = np.linalg.norm(camera - subject)
    to_camera = (camera - subject) / camera_m
    distance = rng.uniform(0.7, 1.4)
    for _ in range(64):
        away = rng.standard_normal(3)
        away /= np.linalg.norm(away)
        blocks_view = away @ to_camera > 0.85 and distance < camera_m + 0.3
        if away @ to_camera > -0.2 and away[1] > -0.1 and not blocks_view:
            break
    size = float(rng.uniform(*size_m))
    position = subject + distance * away
    if room is not None:
        low, high = room_box(room)
        position = np.clip(position, low + _OFF_WALL_M, high - _OFF_WALL_M)
    return _area_light(position, subject, subject, size, irradiance * _white(rng))


def _near_ceiling(
    subject: Array, camera: Array, irradiance: float, *, rng: np.random.Generator
) -> AreaLight:
    """One lamp above the subject, towards the camera."""
    aside = rng.uniform(-0.5, 0.5, 2)
    flat = (camera - subject)[[0, 2]]
    aside = aside + flat / max(float(np.linalg.norm(flat)), 1e-6) * rng.uniform(0.2, 0.7)
    position = subject + np.array([aside[0], rng.uniform(0.7, 0.95), aside[1]])
    size = float(rng.uniform(0.15, 0.5))
    return _area_light(position, subject, subject, size, irradiance * np.array(_tint(1.0, rng)))


def _room_lamps(
    subject: Array, camera: Array, room: Background, rng: np.random.Generator
) -> tuple[AreaLight, ...]:
    """Draw a ceiling lamp and a window, and which of them leads."""
    low, high = room_box(room)
    share = rng.uniform(0.15, 0.9)
    total = rng.uniform(2.2, 3.6)
    towards = (camera - subject) / np.linalg.norm(camera - subject)
    place = subject + towards * rng.uniform(-0.1, 0.9) + rng.normal(0, 0.35, 3)
    place = np.clip(place, low + 0.35, high - 0.35)
    place[1] = high[1] - 0.01
    panel = float(rng.uniform(0.25, 0.6))
    down = np.array([0.0, -1.0, 0.0])
    ceiling = _area_light(place, place + down, subject, panel, total * (1 - share) * _white(rng))
    middle, inward, size = _window(subject, towards, low, high, rng)
    colour = total * share * _DAYLIGHT * rng.uniform(0.95, 1.05, 3)
    return ceiling, _area_light(middle, middle + inward, subject, size, colour)


def room_box(room: Background) -> tuple[Array, Array]:
    """Return the lowest and highest corner (3,) of a room, world, metres."""
    centre = np.array(room.centre_m)
    half = room.distance_m + np.array(room.stretch_m)
    low = np.array([centre[0] - half[0], 0.0, centre[2] - half[1]])
    return low, np.array([centre[0] + half[0], room.ceiling_m, centre[2] + half[1]])


def _window(
    subject: Array, towards: Array, low: Array, high: Array, rng: np.random.Generator
) -> tuple[Array, Array, float]:
    """Choose a wall on the camera's side, mostly, and a place for a square window in it."""
    walls = [(axis, side) for axis in (0, 2) for side in (0, 1)]
    facing = [towards[axis] * (1 if side else -1) for axis, side in walls]
    front = [k for k in range(4) if facing[k] > 0.1]
    back = [k for k in range(4) if -0.6 < facing[k] <= 0.1]
    few = rng.random() < 0.2 and back
    # Straight above the subject a camera looks at no wall more than at another.
    axis, side = walls[int(rng.choice(back if few or not front else front))]
    inward = np.zeros(3)
    inward[axis] = -1.0 if side else 1.0
    along = 2 - axis
    size = float(rng.uniform(0.7, min(1.3, high[1] - 0.9)))
    middle = subject.copy()
    middle[axis] = (high if side else low)[axis] + 0.02 * inward[axis]
    half = size / 2 + 0.05
    middle[along] = np.clip(
        subject[along] + rng.uniform(-0.9, 0.9), low[along] + half, high[along] - half
    )
    middle[1] = np.clip(rng.uniform(1.3, 1.7), 0.4 + half, high[1] - half)
    return middle, inward, size


def _area_light(
    position: Array, target: Array, subject: Array, size: float, irradiance: Array
) -> AreaLight:
    """Give a lamp the radiance that brings a colour's worth of irradiance to the subject."""
    axis = (target - position) / np.linalg.norm(target - position)
    offset = subject - position
    distance = float(np.linalg.norm(offset))
    cosine = max(float(axis @ offset) / distance, 0.25)
    return AreaLight(
        position_m=rounded(position),
        target_m=rounded(target),
        size_m=round(size, 6),
        radiance_rgb=rounded(irradiance * distance**2 / (size**2 * cosine)),
    )


def _sky(subject: Array, camera: Array, panorama: Picture | None, rng: np.random.Generator) -> Sky:
    """Sun and sky, clear, hazy or overcast; the sun is not straight behind the subject."""
    towards = (camera - subject) / np.linalg.norm(camera - subject)
    for _ in range(64):
        azimuth, height = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(12, 70))
        sun = np.array(
            [np.cos(height) * np.sin(azimuth), np.sin(height), np.cos(height) * np.cos(azimuth)]
        )
        if sun @ towards > -0.45:
            break
    share = (1.0, 0.35, 0.01)[int(rng.choice(3, p=[0.5, 0.2, 0.3]))]
    return Sky(
        sun_direction=rounded(sun),
        turbidity=round(float(rng.uniform(2.5, 8.0)), 6),
        sun_share=share,
        irradiance=round(float(rng.uniform(2.5, 4.0)), 6),
        turn_rad=round(float(rng.uniform(0, 2 * np.pi)), 6),
        file=panorama,
    )


def _white(rng: np.random.Generator) -> Array:
    """Colour of a lamp, unit mean, between two neighbours of the common whites."""
    place = rng.uniform(0, len(_WHITES) - 1)
    k = min(int(place), len(_WHITES) - 2)
    colour = _WHITES[k] + (place - k) * (_WHITES[k + 1] - _WHITES[k])
    return np.asarray(colour / colour.mean())


def _tint(level: float, rng: np.random.Generator) -> Vec3:
    """Light between warm and cool: neutral grey with up to +-12 % red against blue."""
    warmth = rng.uniform(-0.12, 0.12)
    return rounded(level * np.array([1 + warmth, 1.0, 1 - warmth]))
