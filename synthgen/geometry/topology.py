"""Open boundaries of triangle meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from synthgen.errors import ShapeError


def boundary_loops(faces: NDArray[Any]) -> list[NDArray[np.int64]]:
    """Return the boundary loops of a triangle mesh.

    Parameters
    ----------
    faces : (F, 3) int

    Returns
    -------
    list of (n,) int64
        Vertex ids in the direction of the faces' own edges, the longest loop first, each loop
        starting at its smallest id.

    Raises
    ------
    ShapeError
        If a boundary vertex belongs to several loops (the surface touches itself in a point), or
        the boundary does not close (an edge has three faces, or faces turned against each other).
    """
    following: dict[int, int] = {}
    for a, b in boundary_edges(faces).tolist():
        if a in following:
            raise ShapeError(f"vertex {a} lies on several boundary loops; split it first")
        following[a] = b
    loops = []
    while following:
        loop = [min(following)]
        while (step := following.pop(loop[-1], None)) != loop[0]:
            if step is None:
                raise ShapeError(
                    f"the boundary ends at vertex {loop[-1]}; the mesh must be edge-manifold, its "
                    "faces turned the same way"
                )
            loop.append(step)
        loops.append(np.array(loop, dtype=np.int64))
    return sorted(loops, key=len, reverse=True)


def boundary_edges(faces: NDArray[Any]) -> NDArray[np.int64]:
    """Return the directed edges (n, 2) of faces (F, 3) that no other face runs back along."""
    f = np.asarray(faces, dtype=np.int64)
    start, end = f.ravel(), np.roll(f, -1, axis=1).ravel()
    n = int(f.max(initial=0)) + 1
    there = np.unique(start * n + end)  # an edge as one number, which sorts as its two ends do
    back = np.sort(there % n * n + there // n)
    open_ = there[~np.isin(there, back, assume_unique=True)]
    return np.stack([open_ // n, open_ % n], axis=1)


def pieces(faces: NDArray[Any], n: int) -> NDArray[np.int64]:
    """Return for each of n vertices the number of the connected piece of faces (F, 3) it is in."""
    f = np.asarray(faces, dtype=np.int64)
    a, b = np.concatenate([f[:, [0, 1]], f[:, [1, 2]]]).T
    graph = sparse.coo_matrix((np.ones(len(a), bool), (a, b)), (n, n))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)
