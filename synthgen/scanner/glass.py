"""Light through a plane-parallel slab, exactly: it leaves in its own direction, shifted.

A ray at angle theta to the normal leaves the slab as if it had started from a point moved along
the normal by ``t (1 - cos(theta) / sqrt(n^2 - sin(theta)^2))``, so that seeing through a slab is
seeing from a shifted eye, with a shift that depends on the angle. The functions take NumPy and
Dr.Jit numbers alike; ``sqrt`` is the library's own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.scanner.rig import Glass

Array = NDArray[np.float64]


def normal_shift(
    cosine: Any, thickness: Any, ior: Any, sqrt: Callable[[Any], Any] = np.sqrt
) -> Any:
    """Return by how much a ray's origin moves along the normal, in the direction of travel.

    Parameters
    ----------
    cosine : number or array
        |cos| of the angle in air against the normal.
    thickness : number or array
        Metres; 0 is no glass.
    ior : number
    """
    return thickness * (1 - cosine / sqrt(ior * ior - 1 + cosine * cosine))


def transmittance(cosine: Any, ior: Any, sqrt: Callable[[Any], Any] = np.sqrt) -> Any:
    """Return the share of unpolarised light that passes a slab, all inner reflections summed.

    Fresnel at both faces, no absorption: (1 - R) / (1 + R) for each polarisation.
    """
    inside = sqrt(ior * ior - 1 + cosine * cosine)
    s = (cosine - inside) / (cosine + inside)
    p = (ior * ior * cosine - inside) / (ior * ior * cosine + inside)
    rs, rp = s * s, p * p
    return 0.5 * ((1 - rs) / (1 + rs) + (1 - rp) / (1 + rp))


def thickness_for(glass: Glass | None, position: Array) -> float:
    """Return the thickness that a device at ``position`` (3,) looks through: 0 from above."""
    if glass is None or position[1] > glass.top_m:
        return 0.0
    return glass.thickness_m


def shifted_origins(glass: Glass | None, origin: Array, directions: Array) -> Array:
    """Return where rays (n, 3) from ``origin`` (3,) seem to start once they are past the glass."""
    origins = np.broadcast_to(origin, directions.shape).copy()
    thickness = thickness_for(glass, origin)
    if glass is not None and thickness:
        cosine = np.abs(directions[:, 1]) / np.linalg.norm(directions, axis=1)
        origins[:, 1] += np.sign(directions[:, 1]) * normal_shift(cosine, thickness, glass.ior)
    return origins


def seen_position(glass: Glass | None, eye: Array, points: Array) -> Array:
    """Return where an eye (3,) seems to stand for each point (n, 3) that it sees through the glass.

    The inverse of :func:`shifted_origins`, by fixed-point iteration to 1e-12 m; project a point
    into a camera by moving the camera there.
    """
    eyes = np.broadcast_to(eye, points.shape).copy()
    thickness = thickness_for(glass, eye)
    if glass is None or not thickness:
        return eyes
    for _ in range(60):
        way = points - eyes
        cosine = np.abs(way[:, 1]) / np.linalg.norm(way, axis=1)
        height = eye[1] + np.sign(way[:, 1]) * normal_shift(cosine, thickness, glass.ior)
        done = bool(np.abs(height - eyes[:, 1]).max() < 1e-13)
        eyes[:, 1] = height
        if done:
            break
    return eyes
