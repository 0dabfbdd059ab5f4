"""Lights and backgrounds of the plain first scenes: a constant surround, lamps, a simple room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.sampling.appearance import linear_rgb_from_lab, rounded
from synthgen.scene import AreaLight, Background, Lights
from synthgen.scene.description import Vec3

Array = NDArray[np.float64]


def sample_lights(kind: str, subject: Array, camera: Array, *, rng: np.random.Generator) -> Lights:
    """Draw the lights of one sample.

    Irradiance at the subject is about 2 to 4 in the units in which a white constant surround of
    radiance 1 gives pi.

    Parameters
    ----------
    kind : {"constant", "area", "room"}
        Constant surround only; dim surround and one lamp; two ceiling or wall lamps in a room.
    subject, camera : (3,)
        World positions, metres.
    """
    if kind == "constant":
        return Lights(constant_rgb=_tint(rng.uniform(0.6, 1.0), rng))
    if kind == "area":
        lamp = _lamp(subject, camera, rng.uniform(1.5, 4.0), rng=rng)
        return Lights(constant_rgb=_tint(rng.uniform(0.25, 0.6), rng), area=(lamp,))
    lamps = tuple(_ceiling_lamp(subject, share, rng=rng) for share in (2.6, 1.2))
    return Lights(constant_rgb=(0.0, 0.0, 0.0), area=lamps)


def _lamp(
    subject: Array, camera: Array, irradiance: float, *, rng: np.random.Generator
) -> AreaLight:
    """One lamp on the camera's side of the subject, never below it by much."""
    camera_m = np.linalg.norm(camera - subject)
    to_camera = (camera - subject) / camera_m
    distance = rng.uniform(0.7, 1.4)
    for _ in range(64):
        away = rng.standard_normal(3)
        away /= np.linalg.norm(away)
        blocks_view = away @ to_camera > 0.85 and distance < camera_m + 0.3
        if away @ to_camera > -0.2 and away[1] > -0.1 and not blocks_view:
            break
    return _area_light(subject + distance * away, subject, irradiance, rng)


def _ceiling_lamp(subject: Array, irradiance: float, *, rng: np.random.Generator) -> AreaLight:
    position = subject + np.array(
        [rng.uniform(-0.6, 0.6), rng.uniform(0.7, 0.95), rng.uniform(-0.6, 0.6)]
    )
    return _area_light(position, subject, irradiance, rng)


def _area_light(
    position: Array, target: Array, irradiance: float, rng: np.random.Generator
) -> AreaLight:
    size = float(rng.uniform(0.15, 0.5))
    distance = float(np.linalg.norm(position - target))
    colour = np.array(_tint(1.0, rng))
    return AreaLight(
        position_m=rounded(position),
        target_m=rounded(target),
        size_m=round(size, 6),
        radiance_rgb=rounded(colour * irradiance * distance**2 / size**2),
    )


def _tint(level: float, rng: np.random.Generator) -> Vec3:
    """Light between warm and cool: neutral grey with up to +-12 % red against blue."""
    warmth = rng.uniform(-0.12, 0.12)
    return rounded(level * np.array([1 + warmth, 1.0, 1 - warmth]))


def sample_background(
    kind: str, centre: Array, behind_m: float, camera_m: float, *, rng: np.random.Generator
) -> Background:
    """Draw the background.

    Parameters
    ----------
    kind : {"plain", "procedural", "room", "empty"}
    centre : (3,)
        World point that the first camera looks at, metres.
    behind_m : float
        How far subjects reach behind ``centre`` along the optical axis, metres.
    camera_m : float
        Farthest camera from ``centre``, metres; a room must hold it.
    """
    room = kind == "room"
    distance = max(1.0, camera_m + 0.1, behind_m + 0.2) if room else behind_m
    return Background(
        kind=kind,  # type: ignore[arg-type]  # checked by the schema
        colour_rgb=_wall_colour(rng),
        accent_rgb=_wall_colour(rng),
        seed=int(rng.integers(2**31)),
        distance_m=round(float(distance + rng.uniform(0.05, 0.8)), 6),
        centre_m=rounded(centre),
    )


def _wall_colour(rng: np.random.Generator) -> Vec3:
    lab = np.array([rng.uniform(20, 88), rng.normal(0, 7), rng.normal(3, 10)])
    return rounded(linear_rgb_from_lab(lab))
