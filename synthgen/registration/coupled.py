"""The coupled stage: a free mesh V tied to the model M by its edges (Eq. 7, 20, 23).

With correspondences fixed, point-to-plane distance is quadratic in V, so each round solves one
sparse system, then draws the model's parameters after V through the same edges. Point-to-plane
cannot see a vertex slide along the surface: the free mesh is a measure of the *surface*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import linalg

from synthgen.geometry.normals import face_cross, unit
from synthgen.registration.scan import Scan
from synthgen.registration.surface import Found, Placed, Surface
from synthgen.registration.terms import GemanMcClure, Pairs, Term, closest

Array = NDArray[np.float64]
DIRECT_VERTICES = 4000


@dataclass(frozen=True)
class CoupledSettings:
    """Of the coupled stage.

    Attributes
    ----------
    points, rounds : int
    edge_sd_m : float
        Standard deviation of the difference between an edge of V and of M, metres.
    offset_sd_m : float
        Loose tie of vertices to the model, which holds what no point sees.
    sigma_m, cut_m, cosine : float
        Of correspondences, as in :class:`synthgen.registration.schedule.Stage`.
    tangential : float
        Share of the point-to-point distance.
    """

    points: int = 25_000
    rounds: int = 4
    edge_sd_m: float = 1e-3
    offset_sd_m: float = 0.02
    sigma_m: float = 1e-3
    cut_m: float = 4e-3
    cosine: float = 0.5
    tangential: float = 0.02


@dataclass(frozen=True, eq=False)
class Coupled:
    """Free vertices (V, 3) and the parameters (n,) that follow them."""

    vertices: Array
    x: Array


@dataclass(frozen=True, eq=False)
class EdgeCoupling:
    """Edge coupling (Eq. 7): sum over edges of |e_V - e_M|^2 / sd^2.

    ``laplacian`` (V, V) is D^T D of the edge differences D.
    """

    laplacian: sparse.csr_matrix
    edges: NDArray[np.int64]
    sd_m: float

    def residual(self, free: Array, model: Array) -> Array:
        """Edge differences in standard deviations, (E, 3)."""
        i, j = self.edges.T
        off = free - model
        return np.asarray((off[i] - off[j]) / self.sd_m)

    def model_equations(self, free: Array, placed: Placed) -> tuple[Array, Array]:
        """Return normal equations (n, n), (n,) of the parameters for a fixed free mesh."""
        n = placed.surface.n
        hessian, gradient = np.zeros((n, n)), np.zeros(n)
        off = placed.vertices - free
        for axis in range(3):
            rows = np.ascontiguousarray(placed.jacobian[:, axis])
            spread = self.laplacian @ rows
            hessian += rows.T @ spread
            gradient += spread.T @ off[:, axis]
        return hessian / self.sd_m**2, gradient / self.sd_m**2


@lru_cache(maxsize=8)
def edge_coupling(surface: Surface, sd_m: float) -> EdgeCoupling:
    """Edges of a surface and their Laplacian."""
    f = surface.faces
    pairs = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
    edges = np.unique(pairs, axis=0)
    m, v = len(edges), surface.n_vertices
    rows = np.repeat(np.arange(m), 2)
    signs = np.tile([1.0, -1.0], m)
    d = sparse.csr_matrix((signs, (rows, edges.ravel())), (m, v))
    return EdgeCoupling((d.T @ d).tocsr(), edges, sd_m)


def couple(
    surface: Surface,
    scan: Scan,
    x: Array,
    priors: Sequence[Term],
    noise_m: float,
    settings: CoupledSettings = CoupledSettings(),
) -> Coupled:
    """Free the mesh from the model, starting at a good fit x."""
    coupling = edge_coupling(surface, settings.edge_sd_m)
    placed = surface.at(x)
    free = placed.vertices.copy()
    for _ in range(settings.rounds):
        pairs = _match(surface, free, scan, settings)
        free = _solve(free, placed.vertices, pairs, scan, coupling, noise_m, settings)
        placed = _follow(placed, free, coupling, priors)
    return Coupled(free, placed.x)


class _Free:
    """A free mesh in the shape that :func:`closest` reads."""

    def __init__(self, surface: Surface, vertices: Array) -> None:
        self.surface, self.vertices = surface, vertices
        self.normals = unit(surface._incidence @ face_cross(vertices, surface.faces))

    def nearest(self, points: Array, neighbours: int = 1) -> Found:
        return self.surface.nearest(self.vertices, points, neighbours)


def _match(surface: Surface, free: Array, scan: Scan, settings: CoupledSettings) -> Pairs:
    mesh: Any = _Free(surface, free)
    n = settings.points
    return closest(mesh, scan.points[:n], scan.normals[:n], cut_m=settings.cut_m,
                   cosine=settings.cosine)  # fmt: skip


def _solve(
    free: Array,
    model: Array,
    pairs: Pairs,
    scan: Scan,
    coupling: EdgeCoupling,
    noise_m: float,
    settings: CoupledSettings,
) -> Array:
    """Minimise over offsets from the model: data + edges + loose tie."""
    v = len(free)
    w = GemanMcClure(settings.sigma_m).weight(pairs.squared, pairs.kept) / noise_m**2
    used = np.flatnonzero(w)
    t, b, w = pairs.triangle[used], pairs.barycentric[used], w[used]
    target = scan.points[used] - np.einsum("mk,mka->ma", b, model[t]) - pairs.shift[used]
    n = pairs.normal[used]
    rows = np.repeat(np.arange(len(used)), 9)
    columns = (3 * t[:, :, None] + np.arange(3)).ravel()
    values = (b[:, :, None] * n[:, None, :]).ravel()
    A = sparse.csr_matrix((values, (rows, columns)), (len(used), 3 * v))
    B = sparse.csr_matrix((b.ravel(), (np.repeat(np.arange(len(used)), 3), t.ravel())),
                          (len(used), v))  # fmt: skip
    tie = coupling.laplacian / coupling.sd_m**2 + sparse.eye(v) / settings.offset_sd_m**2
    tie = tie + settings.tangential * (B.T @ sparse.diags(w) @ B)
    K = sparse.csc_matrix(A.T @ sparse.diags(w) @ A + sparse.kron(tie, sparse.eye(3)))
    right = A.T @ (w * np.sum(target * n, axis=1))
    right += settings.tangential * (B.T @ (w[:, None] * target)).ravel()
    offset = _solution(K, right, (free - model).ravel())
    return model + offset.reshape(-1, 3)


def _solution(K: sparse.csc_matrix, right: Array, guess: Array) -> Array:
    """Direct for hands, Jacobi-preconditioned conjugate gradients for bodies."""
    if len(right) <= 3 * DIRECT_VERTICES * 2:
        factor = linalg.splu(K, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return np.asarray(factor.solve(right))
    inverse = sparse.diags(1 / K.diagonal())
    return np.asarray(linalg.cg(K, right, x0=guess, rtol=1e-3, maxiter=400, M=inverse)[0])


def _follow(placed: Placed, free: Array, coupling: EdgeCoupling, priors: Sequence[Term]) -> Placed:
    """One Gauss-Newton step of the parameters towards the free mesh; translation by the mean."""
    hessian, gradient = coupling.model_equations(free, placed)
    for term in priors:
        for block in term.blocks(placed, term.match(placed)):
            hessian += block.rows.T @ (block.weight[:, None] * block.rows)
            gradient += block.rows.T @ (block.weight * block.residual)
    at = np.arange(placed.surface.translation.start, placed.surface.translation.stop)
    hessian[at, at] += hessian.diagonal().max()  # edges cannot see translation
    step = -np.linalg.solve(hessian + 1e-9 * np.diag(hessian.diagonal()), gradient)
    step[at] = 0
    x = placed.x + step
    moved = placed.surface.at(x)
    x = x.copy()
    x[at] += (free - moved.vertices).mean(axis=0)
    return placed.surface.at(x)
