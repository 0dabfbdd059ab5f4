"""Subsurface blur in surface space: irradiance spreads along the mesh as heat does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]

_STEPS = 3
_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class Diffusion:
    """Prepared heat flow over one mesh.

    Attributes
    ----------
    matrix : (V, V) sparse
        ``M + t L``: lumped mass and cotangent Laplacian, one implicit step.
    mass : (V,)
    inverse_diagonal : (V,)
    """

    matrix: sparse.csr_matrix
    mass: Array
    inverse_diagonal: Array

    def apply(self, values: Array) -> Array:
        """Spread values (V,) with the prepared sigma; their integral over the surface stays."""
        x = np.asarray(values, dtype=np.float64)
        for _ in range(_STEPS):
            x = self._solve(self.mass * x, x)
        return x

    def _solve(self, right: Array, guess: Array) -> Array:
        """Conjugate gradients with the diagonal as preconditioner, from the last step's values."""
        x = guess.copy()
        residual = right - self.matrix @ x
        direction = self.inverse_diagonal * residual
        square = residual @ direction
        target = _TOLERANCE**2 * float(right @ (self.inverse_diagonal * right))
        for _ in range(200):
            if square <= target:
                break
            image = self.matrix @ direction
            along = square / (direction @ image)
            x += along * direction
            residual -= along * image
            scaled = self.inverse_diagonal * residual
            before, square = square, residual @ scaled
            direction *= square / before
            direction += scaled
        return x


def heat_flow(vertices: NDArray[Any], faces: NDArray[Any], sigma_m: float) -> Diffusion:
    """Prepare heat flow whose kernel has sigma ``sigma_m`` per axis (time sigma^2 / 2).

    Parameters
    ----------
    vertices : (V, 3) float, metres
    faces : (F, 3) int
    sigma_m : float
    """
    v = np.asarray(vertices, dtype=np.float64)
    f = np.asarray(faces, dtype=np.int64)
    laplacian = -igl.cotmatrix(v, f)
    mass = np.asarray(igl.massmatrix(v, f, igl.MASSMATRIX_TYPE_BARYCENTRIC).diagonal())
    mass = np.maximum(mass, 1e-3 * mass.mean())  # vertices without area, or without a face
    matrix = sparse.csr_matrix(sparse.diags(mass) + (sigma_m**2 / 2 / _STEPS) * laplacian)
    return Diffusion(matrix, mass, 1 / matrix.diagonal())
