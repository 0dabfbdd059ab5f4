"""What a unit's cameras record of a scene under speckle, in counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.scanner.rig import Unit


@dataclass(frozen=True, eq=False)
class Exposure:
    """Pictures of one unit.

    Attributes
    ----------
    unit : Unit
    left, right : (H, W) uint8 or uint16
        Raw counts (distorted, not rectified), ``rig.grey.bits`` deep.
    colour : (H, W, 3) uint8 or None
        sRGB under white light, raw geometry of the colour camera.
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
    colour: NDArray[np.uint8] | None
    time_s: float
    gain: float
    problem: str | None


# The contract, being built:
#   stage = prepare(scene, rig, *, rng, effects=Effects())     uploads, bakes; once per scan
#   shot = expose(stage, unit, *, rng) -> Exposure
#   see(stage, camera, pixels, *, time_s) -> Sight             truth, synthgen/scanner/truth.py
# where ``camera`` is a *true* camera of the unit, ``pixels`` (n, 2) raw pixel positions (x, y), and
#   Sight.solid (n,) -1 nothing; .face (n,) row of solid.faces; .barycentric (n, 3);
#   .point_m (n, 3) float64 rig frame; .depth_z_m (n,) along the camera's axis, 0 nothing
#   seen_from(stage, camera, points_m, *, time_s) -> (n,) bool  nothing between point and camera
