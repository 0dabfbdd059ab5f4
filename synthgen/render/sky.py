"""Light from all around as one map of radiance: sun and sky, or the user's panorama.

One small map serves both, so that they share kernels; the sun is kept as energy, not as a pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.render import backend
from synthgen.scene import Sky
from synthgen.scene.files import read_panorama

Array = NDArray[np.float64]
Image = NDArray[np.float32]

WIDTH_PX, HEIGHT_PX = 512, 256
_GROUND_ALBEDO = 0.2
_SUN_HALF_ANGLE = np.deg2rad(0.2665)
# Mean over centre of the sun's disc: its limb is darker.
_LIMB = 0.83


def directions() -> tuple[Array, Array]:
    """Return unit world directions (H, W, 3) of the map's texels and solid angles (H, W), sr."""
    theta = (np.arange(HEIGHT_PX) + 0.5) / HEIGHT_PX * np.pi
    phi = (np.arange(WIDTH_PX) + 0.5) / WIDTH_PX * 2 * np.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    away = np.stack([np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)], axis=-1)
    return away, np.sin(t) * (np.pi / HEIGHT_PX) * (2 * np.pi / WIDTH_PX)


def radiance_of(sky: Sky) -> Image:
    """Return the radiance map (256, 512, 3) of a sky, scaled to its irradiance.

    The sun's disc is one texel wide or less; its energy (radiance of the disc over its solid
    angle) is spread over the texels within 0.6 degrees, so that it is right whatever their size.
    """
    away, solid_angle = directions()
    if sky.file is not None:
        radiance = read_panorama(sky.file).astype(np.float64)
        # Columns run against a turn about y, which takes z to x.
        shift = round(-sky.turn_rad / (2 * np.pi) * WIDTH_PX)
        radiance = np.roll(radiance, shift, axis=1)
    else:
        radiance = _sun_and_sky(sky, away, solid_angle)
    return np.asarray(radiance * _scale(radiance, away, solid_angle, sky.irradiance), np.float32)


def _sun_and_sky(sky: Sky, away: Array, solid_angle: Array) -> Array:
    sun = np.array(sky.sun_direction)
    dome = np.maximum(_evaluate(sky, away.reshape(-1, 3), sun_scale=0.0), 0)
    radiance = dome.reshape(HEIGHT_PX, WIDTH_PX, 3)
    disc = _LIMB * _evaluate(sky, sun[None], sun_scale=1.0)[0]
    energy = disc * np.pi * _SUN_HALF_ANGLE**2 * sky.sun_share
    near = away @ sun > np.cos(np.deg2rad(0.6))
    radiance[near] += energy / solid_angle[near].sum()
    if sky.sun_share < 0.1:  # overcast: the dome evens out and loses its blue
        grey = (radiance * solid_angle[..., None])[: HEIGHT_PX // 2].sum(axis=(0, 1)).mean()
        height = np.clip(away[..., 1], 0, 1)[..., None]
        cloud = grey / np.pi * (1 + 2 * height) / 3 * np.array([0.97, 1.0, 1.04])
        up = away[..., 1] > 0
        radiance[up] = 0.25 * radiance[up] + 0.75 * np.broadcast_to(cloud, radiance.shape)[up]
    return radiance


def _evaluate(sky: Sky, away: Array, *, sun_scale: float) -> Array:
    """Radiance (n, 3) of Mitsuba's model in world directions (n, 3)."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    emitter = mi.load_dict(
        {
            "type": "sunsky",
            "sun_direction": list(sky.sun_direction),
            "turbidity": sky.turbidity,
            "albedo": _GROUND_ALBEDO,
            "sun_scale": sun_scale,
            "sky_scale": 1.0,
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90),  # its up is z
        }
    )
    hit = dr.zeros(mi.SurfaceInteraction3f, len(away))
    hit.wi = mi.Vector3f(*(mi.Float(backend.aligned(-c)) for c in away.T))
    return np.array(emitter.eval(hit), dtype=np.float64).T


def _scale(radiance: Array, away: Array, solid_angle: Array, irradiance: float) -> float:
    """Return the factor that gives a surface facing the light's mean direction its irradiance."""
    grey = radiance.mean(axis=-1) * solid_angle
    towards = (away * grey[..., None]).sum(axis=(0, 1))
    length = float(np.linalg.norm(towards))
    facing = towards / length if length > 1e-12 else np.array([0.0, 1.0, 0.0])
    received = float((grey * np.maximum(away @ facing, 0)).sum())
    return irradiance / max(received, 1e-12)


def padded(radiance: Image) -> Image:
    """Lay a map out as Mitsuba's envmap keeps it: its last and first columns repeated around it."""
    return np.concatenate([radiance[:, -1:], radiance, radiance[:, :1]], axis=1)
