"""Soft joint limits: violations of the anatomical ranges, in units of a few degrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.registration.surface import Placed, left_jacobian
from synthgen.registration.terms import Block
from synthgen.sampling.limits import JointLimits, frames_of, to_angles

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LimitPrior:
    """Cost of leaving the joint limits: (violation / sd)^2 for each of the 45 finger angles.

    Attributes
    ----------
    where : slice
        The hand's 48 angles in the vector, root first.
    limits : JointLimits
    sd_rad : float
    """

    where: slice
    limits: JointLimits
    sd_rad: float = 0.05
    weight: float = 1.0

    def match(self, placed: Placed) -> None:
        """Nothing to find."""

    def beyond(self, placed: Placed) -> Array:
        """Signed violations (16, 3), radians; zero within the limits and for the root."""
        angles = to_angles(self.limits, placed.x[self.where].reshape(16, 3))
        low, high = self.limits.range[..., 0], self.limits.range[..., 1]
        result: Array = angles - np.clip(angles, low, high)
        result[0] = 0
        return result

    def cost(self, placed: Placed, match: None) -> float:
        """Return squared violations in standard deviations."""
        return self.weight * float(np.sum((self.beyond(placed) / self.sd_rad) ** 2))

    def blocks(self, placed: Placed, match: None) -> list[Block]:
        """Rows of violated angles only."""
        beyond = self.beyond(placed)
        joint, axis = np.nonzero(beyond)
        rows = np.zeros((len(joint), placed.surface.n))
        if len(joint):  # mostly none is
            slopes = angle_slopes(self.limits, placed.x[self.where].reshape(16, 3))
            at = self.where.start + 3 * joint[:, None] + np.arange(3)
            rows[np.arange(len(joint))[:, None], at] = slopes[joint, axis] / self.sd_rad
        residual = beyond[joint, axis] / self.sd_rad
        return [Block(residual, rows, np.full(len(joint), self.weight))]


def angle_slopes(limits: JointLimits, pose: Array) -> Array:
    """Differentiate (16, 3, 3) the anatomical angles by the axis-angle vectors (16, 3).

    In a joint's frame R = Rx(a) Ry(b) Rz(c), whose angular velocity is
    ``[e_x, Rx e_y, Rx Ry e_z] (a', b', c')``.
    """
    frame, sign = frames_of(limits)
    angles = to_angles(limits, pose) * sign
    a, b = angles[:, 0], angles[:, 1]
    velocity = np.zeros((16, 3, 3))
    velocity[:, 0, 0] = 1
    velocity[:, 1, 1], velocity[:, 2, 1] = np.cos(a), np.sin(a)
    velocity[:, 0, 2] = np.sin(b)
    velocity[:, 1, 2], velocity[:, 2, 2] = -np.sin(a) * np.cos(b), np.cos(a) * np.cos(b)
    turned = np.linalg.solve(velocity, frame @ left_jacobian(pose))
    result: Array = turned * sign[:, :, None]
    return result
