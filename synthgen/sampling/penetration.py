"""Self-penetration of a posed hand: how deep one part's surface lies inside another part.

The hand is cut into six solids, the palm and five fingers; each solid is the part's own faces,
each opening closed by a cone. Points near a solid along the surface (its web) are left out, since
neighbouring skin always folds into it a little.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from synthgen.geometry.topology import boundary_edges
from synthgen.models import ManoModel

# Points closer than this along the surface belong to the fold between two parts, metres.
FOLD_M = 0.02


@dataclass(frozen=True, eq=False)
class _Solid:
    faces: NDArray[np.int64]
    closed: NDArray[np.int64]
    fans: tuple[NDArray[np.int64], ...]
    probes: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PenetrationProbe:
    """The palm and the fingers of one hand topology as closed solids with their probe points."""

    n_vertices: int
    solids: tuple[_Solid, ...]

    def depth_m(self, vertices: NDArray[np.floating]) -> float:
        """Return the deepest self-penetration.

        Parameters
        ----------
        vertices : (V, 3) float
            Posed hand vertices, metres.

        Returns
        -------
        float
            Largest distance, metres, from a point inside a foreign part to that part's surface;
            0 where nothing penetrates.
        """
        points = np.asarray(vertices, dtype=np.float64)
        return max((_depth(points, solid) for solid in self.solids), default=0.0)


@lru_cache(maxsize=8)
def probe_of(model: ManoModel) -> PenetrationProbe:
    """Cut a MANO-form hand into its six solids, once per model and process."""
    part = part_of_finger(model)
    faces = np.asarray(model.faces, dtype=np.int64)
    face_part = np.sort(part[faces], axis=1)[:, 1]  # majority; the middle one breaks ties
    along = _edge_graph(np.asarray(model.v_template, dtype=np.float64), faces)
    solids = tuple(_solid(faces[face_part == p], part, p, along) for p in range(6))
    return PenetrationProbe(len(part), solids)


def part_of_finger(model: ManoModel) -> NDArray[np.int64]:
    """Return (V,) 0 for the palm, 1-5 for the finger (MANO order) that moves each vertex most."""
    joint = np.asarray(model.weights).argmax(axis=1)
    return np.where(joint == 0, 0, (joint + 2) // 3)


def _solid(
    faces: NDArray[np.int64],
    part: NDArray[np.int64],
    own: int,
    along: sparse.csr_matrix,
) -> _Solid:
    ids = np.unique(faces)
    reach = csgraph.dijkstra(along, directed=False, indices=ids, limit=FOLD_M, min_only=True)
    probes = np.flatnonzero(np.isinf(reach) & (part != own))
    edges = boundary_edges(faces)
    n = int(faces.max()) + 1
    touch = sparse.coo_matrix((np.ones(len(edges)), edges.T), (n, n))
    hole = csgraph.connected_components(touch, directed=False)[1][edges[:, 0]]
    fans = tuple(np.unique(edges[hole == h]) for h in np.unique(hole))
    apex = -1 - np.unique(hole, return_inverse=True)[1]
    closing = np.stack([edges[:, 1], edges[:, 0], apex], axis=1)
    return _Solid(faces, np.concatenate([faces, closing]), fans, probes)


def _edge_graph(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> sparse.csr_matrix:
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    length = np.linalg.norm(vertices[i] - vertices[j], axis=1)
    n = len(vertices)
    graph = sparse.coo_matrix((length, (i, j)), (n, n)).tocsr()
    return graph.maximum(graph.T)


def _depth(points: NDArray[np.float64], solid: _Solid) -> float:
    import igl

    own = points[solid.faces]
    low, high = own.min(axis=(0, 1)), own.max(axis=(0, 1))
    near = solid.probes[np.all((points[solid.probes] > low) & (points[solid.probes] < high), 1)]
    if len(near) == 0:
        return 0.0
    centres = np.array([points[loop].mean(axis=0) for loop in solid.fans]).reshape(-1, 3)
    n = len(points)
    cage = np.concatenate([points, centres])
    closed = np.where(solid.closed < 0, n - 1 - solid.closed, solid.closed)
    inside = np.abs(igl.winding_number(cage, closed, points[near])) > 0.5
    if not inside.any():
        return 0.0
    squared = igl.point_mesh_squared_distance(points[near[inside]], points, solid.faces)[0]
    return float(np.sqrt(squared.max()))
