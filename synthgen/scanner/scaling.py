"""The same rig with fewer pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synthgen.errors import ConfigError
from synthgen.geometry.cameras import Camera
from synthgen.scanner.rig import MIN_PIXELS, Calibration, Rig


def scaled(rig: Rig, factor: float) -> Rig:
    """Return the rig with every camera at ``factor`` times its pixels per edge.

    Slides stay as they are; the calibration draw stays the same scanner. What sensors have per
    pixel and per row (full well, noise, blur, delay) stays: these are larger pixels, not fewer of
    the same.

    Raises
    ------
    ConfigError
        If a camera would have fewer than 16 pixels along an edge.
    """
    cameras = [u.nominal.camera(role) for u in rig.units for role in ("left", "right")]
    edge = min(min(camera.width, camera.height) for camera in cameras)
    if not (np.isfinite(factor) and factor * edge >= MIN_PIXELS):
        raise ConfigError(
            f"rig {rig.name} scaled by {factor:g}: {edge} pixels would be {factor * edge:.3g}; a "
            f"camera needs {MIN_PIXELS}, so give at least {MIN_PIXELS / edge:.2g}"
        )
    units = tuple(
        replace(u, nominal=_scale_all(u.nominal, factor), true=_scale_all(u.true, factor))
        for u in rig.units
    )
    return replace(rig, units=units, epipolar_px=tuple(e * factor for e in rig.epipolar_px))


def _scale_all(calibration: Calibration, factor: float) -> Calibration:
    colour = calibration.colour
    return Calibration(
        scale_camera(calibration.left, factor),
        scale_camera(calibration.right, factor),
        None if colour is None else scale_camera(colour, factor),
    )


def scale_camera(camera: Camera, factor: float) -> Camera:
    """Return the camera with ``factor`` times its pixels per edge, seeing the same field."""
    width, height = round(camera.width * factor), round(camera.height * factor)
    sx, sy = width / camera.width, height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=(camera.cx + 0.5) * sx - 0.5,
        cy=(camera.cy + 0.5) * sy - 0.5,
    )
