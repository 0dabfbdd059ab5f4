"""Residuals summed over patches of skin: noise averages out there, a misfit does not.

Single residuals say little about a finger bent the wrong way inside a fist: most are as small as
the noise. Their means over some tens of points around one vertex are not: beside a right fit they
are white, beside a wrong one they are biased. Detail that no model expresses biases them all over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.registration.correspondences import Pairs
from synthgen.registration.surface import Placed

Array = NDArray[np.float64]
# Standard errors of a mean that noise does not reach; points that make a mean; patches of a share.
BIASED, LEAST_POINTS, LEAST_PATCHES = 4.0, 5, 20
# A mean below this is the limit of triangles with interpolated normals: on exact depth of smooth
# skin, right fits leave 0.2 mm in places.
LEAST_BIAS_M = 2.5e-4
# Skin moves together over about a vertex and its six neighbours.
TOGETHER = 7
# A misfit below this part of the noise is the fit's own error, no detail of the skin.
LEAST_MISFIT = 0.25


@dataclass(frozen=True, eq=False)
class Patches:
    """Signed residuals around each vertex: how many (V,), their mean (V,), and the points' sd."""

    count: Array
    mean_m: Array
    noise_m: float

    @property
    def used(self) -> NDArray[np.bool_]:
        """Vertices (V,) with enough points."""
        return np.asarray(self.count >= LEAST_POINTS)

    @property
    def biased(self) -> NDArray[np.bool_]:
        """Vertices (V,) whose mean residual is no noise."""
        error = self.noise_m / np.sqrt(np.maximum(self.count, 1))
        return np.asarray(
            self.used & (np.abs(self.mean_m) > np.maximum(BIASED * error, LEAST_BIAS_M))
        )

    def biased_share(self, part: NDArray[np.int64], parts: int) -> Array:
        """Share of biased patches by part (parts,); NaN where a part has few patches."""
        number = np.bincount(part[self.used], minlength=parts)
        hits = np.bincount(part[self.biased], minlength=parts)
        return np.where(number >= LEAST_PATCHES, hits / np.maximum(number, 1), np.nan)

    @property
    def misfit_m(self) -> float:
        """Standard deviation of the skin about the model beyond noise, metres."""
        if self.used.sum() < LEAST_PATCHES:
            return 0.0
        expected = self.noise_m**2 / self.count[self.used]
        excess = float(np.mean(self.mean_m[self.used] ** 2 - expected))
        return float(np.sqrt(max(excess - (LEAST_MISFIT * self.noise_m) ** 2, 0.0)))

    def effective(self, points: float) -> float:
        """Points of independent noise that tell as much as ``points`` with a misfit.

        The misfit is one error per patch of neighbours, however many points measure it:
        ``noise^2 / n_eff = noise^2 / points + misfit^2 / patches``.
        """
        patches = max(self.used.sum() / TOGETHER, 1.0)
        variance = self.noise_m**2 / points + self.misfit_m**2 / patches
        return float(self.noise_m**2 / variance)


def patches_of(
    placed: Placed, pairs: Pairs, points: Array, normals: Array, noise_m: float
) -> Patches:
    """Sum the residuals of matched points (m, 3) around the nearest corner of each triangle."""
    foot = np.einsum("mk,mka->ma", pairs.barycentric, placed.vertices[pairs.triangle])
    residual = np.sum((points - foot - pairs.shift) * pairs.normal, axis=1)
    facing = np.sum(pairs.normal * normals, axis=1) > 0.3
    used = pairs.kept & facing & (np.abs(residual) < 4 * noise_m)
    vertex = pairs.corner[used]
    count = np.bincount(vertex, minlength=len(placed.vertices)).astype(np.float64)
    total = np.bincount(vertex, residual[used], len(placed.vertices))
    return Patches(count, total / np.maximum(count, 1), noise_m)
