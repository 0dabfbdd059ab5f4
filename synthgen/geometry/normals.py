"""Normals of triangle meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


def face_cross(vertices: NDArray[Any], faces: NDArray[Any]) -> NDArray[np.float64]:
    """Return (F, 3) edge cross products: normal direction, length twice the area."""
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    ux, uy, uz = (corners[:, 1] - corners[:, 0]).T
    vx, vy, vz = (corners[:, 2] - corners[:, 0]).T
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx], axis=1)


def vertex_normals(vertices: NDArray[Any], faces: NDArray[Any]) -> NDArray[np.float64]:
    """Area-weighted unit vertex normals.

    Parameters
    ----------
    vertices : (V, 3) float
    faces : (F, 3) int
        Counter-clockwise seen from outside.

    Returns
    -------
    (V, 3) float64
        Zero where a vertex has no face.
    """
    return unit(incidence(faces, len(vertices)) @ face_cross(vertices, faces))


def incidence(faces: NDArray[Any], n_vertices: int) -> sparse.csr_matrix:
    """Return the (V, F) 0/1 matrix that sums faces into their vertices."""
    n = len(faces)
    rows, columns = np.asarray(faces).ravel(), np.repeat(np.arange(n), 3)
    return sparse.csr_matrix((np.ones(3 * n), (rows, columns)), (n_vertices, n))


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale vectors (..., 3) to length 1; zero stays zero."""
    length = np.sqrt(np.einsum("...k,...k->...", vectors, vectors))[..., None]
    result: NDArray[np.float64] = vectors / np.maximum(length, 1e-300)
    return result
