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
from synthgen.registration.body_kernels import plane_blocks, plane_product, plane_pull
from synthgen.registration.body_surface import BodySurface
from synthgen.registration.scan import Scan
from synthgen.registration.surface import Found, Placed, Surface
from synthgen.registration.terms import GemanMcClure, Pairs, Term, closest

Array = NDArray[np.float64]
MOST_STEPS, ENOUGH = 400, 1e-3


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
    follow : bool
        Whether the parameters are drawn after the free mesh (needs the whole Jacobian).
    """

    points: int = 25_000
    rounds: int = 4
    edge_sd_m: float = 1e-3
    offset_sd_m: float = 0.02
    sigma_m: float = 1e-3
    cut_m: float = 4e-3
    cosine: float = 0.5
    tangential: float = 0.02
    follow: bool = True


HAND = CoupledSettings()
BODY = CoupledSettings(points=40_000, edge_sd_m=2e-3, sigma_m=2e-3, cut_m=10e-3, follow=False)


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
    settings: CoupledSettings | None = None,
) -> Coupled:
    """Free the mesh from the model, starting at a good fit x; settings: None for the usual ones."""
    if settings is None:
        settings = BODY if isinstance(surface, BodySurface) else HAND
    coupling = edge_coupling(surface, settings.edge_sd_m)
    placed = surface.at(x)
    free = placed.vertices.copy()
    for _ in range(settings.rounds):
        pairs = _match(surface, free, scan, settings)
        planes = _planes(placed.vertices, pairs, scan, noise_m, settings)
        solve = _relaxed if isinstance(surface, BodySurface) else _solved
        free = placed.vertices + solve(free - placed.vertices, planes, coupling, settings)
        if settings.follow:
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


@dataclass(frozen=True, eq=False)
class _Planes:
    """Where points pull: triangles (m, 3), barycentrics, normals (m, 3), weights (m,), targets.

    ``target`` (m, 3) is the offset from the model that would bring the surface to the point.
    """

    triangle: NDArray[np.int64]
    barycentric: Array
    normal: Array
    weight: Array
    target: Array


def _planes(
    model: Array, pairs: Pairs, scan: Scan, noise_m: float, settings: CoupledSettings
) -> _Planes:
    w = GemanMcClure(settings.sigma_m).weight(pairs.squared, pairs.kept) / noise_m**2
    used = np.flatnonzero(w)
    t, b, w = pairs.triangle[used], pairs.barycentric[used], w[used]
    target = scan.points[used] - np.einsum("mk,mka->ma", b, model[t]) - pairs.shift[used]
    return _Planes(t, b, pairs.normal[used], w, target)


def _solved(
    guess: Array, planes: _Planes, coupling: EdgeCoupling, settings: CoupledSettings
) -> Array:
    """Minimise data + edges + loose tie over offsets from the model, directly (hands)."""
    v, t, b, w, n = len(guess), planes.triangle, planes.barycentric, planes.weight, planes.normal
    rows = np.repeat(np.arange(len(w)), 9)
    columns = (3 * t[:, :, None] + np.arange(3)).ravel()
    values = (b[:, :, None] * n[:, None, :]).ravel()
    A = sparse.csr_matrix((values, (rows, columns)), (len(w), 3 * v))
    B = sparse.csr_matrix((b.ravel(), (np.repeat(np.arange(len(w)), 3), t.ravel())), (len(w), v))
    tie = coupling.laplacian / coupling.sd_m**2 + sparse.eye(v) / settings.offset_sd_m**2
    tie = tie + settings.tangential * (B.T @ sparse.diags(w) @ B)
    K = sparse.csc_matrix(A.T @ sparse.diags(w) @ A + sparse.kron(tie, sparse.eye(3)))
    right = A.T @ (w * np.sum(planes.target * n, axis=1))
    right += settings.tangential * np.asarray(B.T @ (w[:, None] * planes.target)).ravel()
    factor = linalg.splu(K, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return np.asarray(factor.solve(right)).reshape(-1, 3)


def _relaxed(
    guess: Array, planes: _Planes, coupling: EdgeCoupling, settings: CoupledSettings
) -> Array:
    """Minimise the same by conjugate gradients, no matrix made, from a guess (bodies).

    The preconditioner is the inverse of each vertex's own 3 x 3 block.
    """
    p, share = planes, settings.tangential
    tie = (coupling.laplacian / coupling.sd_m**2
           + sparse.eye(len(guess)) / settings.offset_sd_m**2).tocsr()  # fmt: skip
    blocks = tie.diagonal()[:, None, None] * np.eye(3)
    plane_blocks(p.triangle, p.barycentric, p.normal, p.weight, share, blocks)
    inverse = np.linalg.inv(blocks)
    right = np.zeros_like(guess)
    plane_pull(p.triangle, p.barycentric, p.normal, p.weight, share, p.target, right)

    def product(offset: Array) -> Array:
        out = np.asarray(tie @ offset)
        plane_product(p.triangle, p.barycentric, p.normal, p.weight, share, offset, out)
        return out

    x = guess.copy()
    rest = right - product(x)
    z = np.einsum("vab,vb->va", inverse, rest)
    step, gain = z.copy(), float(np.sum(rest * z))
    enough = ENOUGH**2 * float(np.sum(right * np.einsum("vab,vb->va", inverse, right)))
    for _ in range(MOST_STEPS):
        if gain <= enough:
            break
        turned = product(step)
        length = gain / float(np.sum(step * turned))
        x += length * step
        rest -= length * turned
        z = np.einsum("vab,vb->va", inverse, rest)
        before, gain = gain, float(np.sum(rest * z))
        step = z + gain / before * step
    return x


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
