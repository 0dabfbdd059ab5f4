"""Loop subdivision that passes through the given vertices.

Plain Loop or Catmull-Clark subdivision shrinks fingers by some tenths of a millimetre. Here the
control points are solved for, so that after the last step the given vertices lie on the surface;
labels made from the model and pictures of the surface then agree.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg

from synthgen.errors import ShapeError

# Corner barycentrics of the four children of a triangle with edge points ab, bc, ca:
# (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca).
_H = 0.5
CHILDREN = np.array(
    [
        [[1, 0, 0], [_H, _H, 0], [_H, 0, _H]],
        [[_H, _H, 0], [0, 1, 0], [0, _H, _H]],
        [[_H, 0, _H], [0, _H, _H], [0, 0, 1]],
        [[_H, _H, 0], [0, _H, _H], [_H, 0, _H]],
    ]
)


@dataclass(frozen=True, eq=False)
class InterpolatingSubdivision:
    """Smooth refinement of one triangle topology.

    Attributes
    ----------
    faces : (F * 4**levels, 3) int64
        Children of face f are rows ``f * 4**levels`` to ``(f + 1) * 4**levels``.
    corner_barycentrics : (4**levels, 3, 3) float64
        Of each child's corners in its parent face; the same for every face.
    matrix : (Vs, V) sparse
        Plain Loop subdivision of control points.
    linear : (Vs, V) sparse
        Flat subdivision (midpoints), for attributes.
    """

    faces: NDArray[np.int64]
    corner_barycentrics: NDArray[np.float64]
    matrix: sparse.csr_matrix
    linear: sparse.csr_matrix
    _solve: Any

    @staticmethod
    def build(faces: NDArray[Any], n_vertices: int, levels: int = 2) -> InterpolatingSubdivision:
        """Prepare a topology once.

        Parameters
        ----------
        faces : (F, 3) int
            Edge-manifold triangles; open boundaries are allowed.
        n_vertices : int
            Vertices; each must belong to a face.
        levels : int
            0-3 refinements.

        Raises
        ------
        ShapeError
            If an edge has more than two faces, or a vertex none.
        """
        current = np.asarray(faces, dtype=np.int64)
        if not 0 <= levels <= 3:
            raise ShapeError(f"levels={levels}; allowed are 0 to 3")
        if len(np.unique(current)) != n_vertices:
            raise ShapeError(f"{n_vertices - len(np.unique(current))} vertices belong to no face")
        smooth = flat = sparse.identity(n_vertices, format="csr")
        corners = np.eye(3)[None]
        for _ in range(levels):
            step, midpoints, current = _refine(current, smooth.shape[0])
            smooth, flat = (step @ smooth).tocsr(), (midpoints @ flat).tocsr()
            corners = np.einsum("dij,cjk->cdik", CHILDREN, corners).reshape(-1, 3, 3)
        through = linalg.splu(smooth[:n_vertices].tocsc())
        return InterpolatingSubdivision(current, corners, smooth, flat, through.solve)

    def apply(self, vertices: NDArray[Any]) -> NDArray[np.float64]:
        """Refine vertices (V, 3); the first V rows of the result (Vs, 3) equal them."""
        v = np.asarray(vertices, dtype=np.float64)
        if v.shape != (self.matrix.shape[1], 3):
            raise ShapeError(f"vertices {v.shape}; expected {(self.matrix.shape[1], 3)}")
        result: NDArray[np.float64] = self.matrix @ self._solve(v)
        return result


def _refine(
    faces: NDArray[np.int64], n: int
) -> tuple[sparse.csr_matrix, sparse.csr_matrix, NDArray[np.int64]]:
    """One Loop step: (smooth matrix, midpoint matrix, faces), children grouped by parent."""
    edges, inverse, opposite, count = _edges(faces)
    boundary = count == 1
    m = len(edges)
    rows = np.arange(m)
    middle = sparse.csr_matrix((np.full(2 * m, 0.5), (np.repeat(rows, 2), edges.ravel())), (m, n))
    inner = np.where(boundary, 0.5, 0.375)
    ends = sparse.csr_matrix((np.repeat(inner, 2), (np.repeat(rows, 2), edges.ravel())), (m, n))
    wings = sparse.csr_matrix(
        (np.where(boundary[inverse], 0.0, 0.125), (inverse, opposite)), (m, n)
    )
    odd = ends + wings
    even = _even(edges, boundary, n)
    a, b, c = faces.T
    ab, bc, ca = (n + inverse).reshape(3, -1)
    children = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    smooth = sparse.csr_matrix(sparse.vstack([even, odd]))
    flat = sparse.csr_matrix(sparse.vstack([sparse.identity(n), middle]))
    return smooth, flat, children


def _edges(
    faces: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Find unique edges; for the half-edges ab, bc, ca of all faces: edge id, opposite vertex."""
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges, inverse, count = np.unique(
        np.sort(half, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    if count.max() > 2:
        bad = edges[count.argmax()].tolist()
        raise ShapeError(f"edge {bad} has {count.max()} faces; the mesh must be edge-manifold")
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    return edges, inverse.reshape(-1), opposite, count


def _even(edges: NDArray[np.int64], boundary: NDArray[np.bool_], n: int) -> sparse.csr_matrix:
    """Loop's vertex rule; boundary vertices follow the cubic B-spline of the boundary."""
    i, j = edges.T
    ring = sparse.csr_matrix((np.ones(2 * len(edges)), (np.r_[i, j], np.r_[j, i])), (n, n))
    i, j = edges[boundary].T
    rim = sparse.csr_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), (n, n))
    on_rim = np.asarray(rim.sum(axis=1)).ravel() > 0
    valence = np.asarray(ring.sum(axis=1)).ravel()
    beta = (0.625 - (0.375 + 0.25 * np.cos(2 * np.pi / valence)) ** 2) / valence
    inside = sparse.diags(1 - valence * beta) + sparse.diags(beta) @ ring
    outside = 0.75 * sparse.identity(n) + 0.125 * rim
    keep = sparse.diags((~on_rim).astype(float))
    return sparse.csr_matrix(keep @ inside + sparse.diags(on_rim.astype(float)) @ outside)
