"""Elastic targets: the hand as a soft block around rigid bones (as-rigid-as-possible lattice).

The rest hand is filled with a cubic lattice; nodes near the bones move rigidly with them, the
others relax the as-rigid-as-possible energy (Sorkine 2007) over all node pairs of each cell; the
skin rides on the lattice. No self-contact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg
from scipy.spatial import cKDTree

from synthgen.geometry.normals import unit
from synthgen.geometry.topology import boundary_loops
from synthgen.models.joints import MANO16_PARENTS

Array = NDArray[np.float64]
_OFFSETS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


class ElasticHand:
    """A factored lattice around one rest hand.

    Parameters
    ----------
    vertices : (V, 3), faces : (F, 3)
        Rest hand, open at the wrist, metres.
    weights : (V, 16), joints : (16, 3), tips : (5, 3)
    cell_m : float
        Edge of a lattice cell.
    """

    def __init__(
        self,
        vertices: Array,
        faces: NDArray[np.int64],
        weights: Array,
        joints: Array,
        tips: Array,
        cell_m: float = 0.004,
    ) -> None:
        self._nodes, self._corners, self._skin, distance = _lattice(vertices, faces, cell_m)
        self._bone = _cores(self._nodes, distance, joints, tips)
        self._weights = weights[cKDTree(vertices).query(self._nodes)[1]]
        self._fixed = np.flatnonzero(self._bone >= 0)
        self._free = np.flatnonzero(self._bone < 0)
        self._pairs, self._stiffness = _springs(self._nodes, self._corners, cell_m)
        self._rest = self._nodes[self._pairs[:, 0]] - self._nodes[self._pairs[:, 1]]
        self._assemble()

    @property
    def n_nodes(self) -> int:
        """Number of lattice nodes."""
        return len(self._nodes)

    def _assemble(self) -> None:
        n, m = len(self._nodes), len(self._pairs)
        i, j = self._pairs.T
        rows, columns = np.r_[i, j], np.r_[np.arange(m), np.arange(m)]
        self._sum = sparse.csr_matrix((np.ones(2 * m), (rows, columns)), (n, m))
        signed = np.r_[self._stiffness, -self._stiffness]
        self._divergence = sparse.csr_matrix((signed, (rows, columns)), (n, m))
        gradient = sparse.csr_matrix((np.r_[np.ones(m), -np.ones(m)], (rows, columns)), (n, m)).T
        laplacian = (self._divergence @ gradient).tocsr()
        self._solve = linalg.splu(laplacian[self._free][:, self._free].tocsc()).solve
        self._pull = laplacian[self._free][:, self._fixed]

    def pose(self, skin: Array, iterations: int = 25) -> Array:
        """Relax one pose.

        Parameters
        ----------
        skin : (16, 3, 4)
            Rigid motions of the bones from rest (as used for skinning).
        iterations : int
            Local-global steps at most; stops when nothing moves by more than 20 micrometres.

        Returns
        -------
        (V, 3) float64
        """
        moved = np.einsum("kij,nj->nki", skin[..., :3], self._nodes) + skin[..., 3]
        x = np.einsum("nk,nki->ni", self._weights, moved)
        x[self._fixed] = moved[self._fixed, self._bone[self._fixed]]
        i, j = self._pairs.T
        for _ in range(iterations):
            edges = self._stiffness[:, None] * (x[i] - x[j])
            covariance = self._sum @ (edges[:, :, None] * self._rest[:, None]).reshape(-1, 9)
            turn = _closest_rotation(covariance.reshape(-1, 3, 3))
            goal = 0.5 * np.einsum("eij,ej->ei", turn[i] + turn[j], self._rest)
            right = self._divergence @ goal
            update = x.copy()
            update[self._free] = self._solve(right[self._free] - self._pull @ x[self._fixed])
            step = np.abs(update - x).max()
            x = update
            if step < 2e-5:
                break
        return np.asarray(self._skin @ x)


def _closest_rotation(matrix: Array) -> Array:
    u, _, vt = np.linalg.svd(matrix)
    u[..., 2] *= np.linalg.det(u @ vt)[:, None]
    return np.asarray(u @ vt)


def _lattice(
    vertices: Array, faces: NDArray[np.int64], cell: float
) -> tuple[Array, NDArray[np.int64], sparse.csr_matrix, Array]:
    """Nodes (n, 3), cell corners (c, 8), skin matrix (V, n), signed distance (n,)."""
    import igl

    cage, closed = _capped(vertices, faces)
    low = vertices.min(axis=0) - 2 * cell
    counts = np.ceil((np.ptp(vertices, axis=0) + 4 * cell) / cell).astype(np.int64) + 1
    grid = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    cells = grid[np.all(grid < counts - 1, axis=1)]
    points = low + grid * cell
    distance = igl.signed_distance(
        points, cage, closed, sign_type=igl.SIGNED_DISTANCE_TYPE_WINDING_NUMBER
    )[0]

    def flat(index: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.asarray(
            (index[..., 0] * counts[1] + index[..., 1]) * counts[2] + index[..., 2], dtype=np.int64
        )

    corners = flat(cells[:, None] + _OFFSETS)
    home = np.floor((vertices - low) / cell).astype(np.int64)
    keep = (distance[corners].mean(axis=1) < 0) | np.isin(flat(cells), flat(home))
    cells, corners = cells[keep], corners[keep]
    used = np.unique(corners)
    number = np.full(len(points), -1, dtype=np.int64)
    number[used] = np.arange(len(used))
    order = {int(key): row for row, key in enumerate(flat(cells))}
    own = corners[[order[int(key)] for key in flat(home)]]
    inside = (vertices - low) / cell - home
    share = np.prod(np.where(_OFFSETS, inside[:, None], 1 - inside[:, None]), axis=-1)
    rows = np.repeat(np.arange(len(vertices)), 8)
    skin = sparse.csr_matrix(
        (share.ravel(), (rows, number[own].ravel())), (len(vertices), len(used))
    )
    return points[used], number[corners], skin, distance[used]


def _capped(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    loop = boundary_loops(faces)[0]
    centre = vertices[loop].mean(axis=0)
    fan = np.stack([np.roll(loop, -1), loop, np.full(len(loop), len(vertices))], axis=1)
    return np.vstack([vertices, centre]), np.concatenate([faces, fan])


def _cores(nodes: Array, distance: Array, joints: Array, tips: Array) -> NDArray[np.int64]:
    """Bone (0-15) of every rigid node, -1 where soft: the inner half around each bone's shaft."""
    bone = np.full(len(nodes), -1, dtype=np.int64)
    nearest = np.full(len(nodes), np.inf)
    for a, b, owner, low, high in _shafts(joints, tips):
        axis = b - a
        length = np.linalg.norm(axis)
        along = (nodes - a) @ axis / length**2
        foot = a + np.clip(along, 0, 1)[:, None] * axis
        away = np.linalg.norm(nodes - foot, axis=1)
        inner = (distance < 0) & (away <= 0.5 * (away - distance)) & (away < nearest)
        core = inner & (along > low) & (along < high)
        bone[core], nearest[core] = owner, away[core]
    stub = (nodes[:, 0] > joints[0, 0] - 0.005) & (bone < 0)
    bone[stub] = 0
    return bone


def _shafts(joints: Array, tips: Array) -> list[tuple[Array, Array, int, float, float]]:
    """Segments (from, to, owner, share kept from, to): phalanges, then the metacarpals."""
    shafts = []
    for k in range(1, 16):
        last = k % 3 == 0
        parent = MANO16_PARENTS[k]
        if last:
            reach = unit(joints[k] - joints[parent])
            end = joints[k] + reach * ((tips[(k - 1) // 3] - joints[k]) @ reach) * 0.85
        else:
            end = joints[k + 1]
        shafts.append((joints[k], end, k, 0.12 if last else 0.10, 0.97 if last else 0.90))
    shafts += [(joints[0], joints[c], 0, -0.2, 0.95) for c in (1, 4, 7, 10)]
    return shafts


def _springs(
    nodes: Array, corners: NDArray[np.int64], cell: float
) -> tuple[NDArray[np.int64], Array]:
    a, b = np.triu_indices(8, 1)
    pairs = np.sort(np.stack([corners[:, a].ravel(), corners[:, b].ravel()], axis=1), axis=1)
    pairs, count = np.unique(pairs, axis=0, return_counts=True)
    length = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    return pairs, count / (length / cell) ** 2
