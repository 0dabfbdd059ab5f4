"""What things must keep clear of: the subject, the cameras and what they see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, project
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.scene import Thing

Array = NDArray[np.float64]

CLEARANCE_M = 0.006


@dataclass(frozen=True, eq=False)
class Stage:
    """What things must keep clear of.

    ``surface`` (S, 3) world, metres: hand (the first ``n_hand``), arm, what is worn; ``cameras``
    without distortion; ``end`` (E, 3) the arm's open end, world, metres.
    """

    surface: Array
    n_hand: int
    cameras: tuple[Camera, ...]
    end: Array

    @property
    def hand(self) -> Array:
        """The hand's vertices (n, 3)."""
        return self.surface[: self.n_hand]

    def in_frame(self, margin: float = 0.15) -> Array:
        """Vertices (n, 3) that some camera sees, or nearly so."""
        seen = np.zeros(len(self.surface), dtype=bool)
        for camera in self.cameras:
            pixels, z = project(camera, self.surface)
            size = np.array([camera.width, camera.height])
            seen |= np.all((pixels > -margin * size) & (pixels < (1 + margin) * size), axis=1) & (
                z > 0.01
            )
        return self.surface[seen]

    def clear(self, thing: Thing, *, in_view: bool = False) -> bool:
        """Tell whether a thing neither touches the subject nor (unless wanted) hides it."""
        box = _Inside(thing)
        if box.holds(self.surface, CLEARANCE_M).any():
            return False
        for camera in self.cameras:
            if box.holds(camera.position[None], 0.08).any():
                return False
            if not in_view:
                share = np.linspace(0.02, 0.99, 16)[:, None, None]
                rays = camera.position + share * (self.surface[::17] - camera.position)
                if box.holds(rays.reshape(-1, 3), 0.01).any():
                    return False
        return True


class _Inside:
    """Membership in a thing's box, grown by a margin."""

    def __init__(self, thing: Thing) -> None:
        self._R = matrix_from_axis_angle(np.array(thing.turn))
        self._centre, self._half = np.array(thing.position_m), np.array(thing.size_m) / 2

    def holds(self, points: Array, margin: float) -> NDArray[np.bool_]:
        local = np.abs((points - self._centre) @ self._R)
        return np.asarray((local < self._half + margin).all(axis=1))
