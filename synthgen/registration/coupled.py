"""The coupled stage: a free mesh V tied to the model M by its edges (Eq. 7, 20, 23).

With correspondences fixed, point-to-plane distance is quadratic in V and, to first order, the
edges tie the model's parameters to V by least squares. Each round matches once and then alternates
the two a few times: parameters that follow V undo the sliding of its vertices along the surface,
which point-to-plane cannot see and which costs surface error where flat triangles meet curved skin.
With ``follow=0`` (bodies) the model stays, only V is solved for, and priors play no part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from synthgen.registration.free_mesh import (
    Closest,
    Quadratic,
    Topology,
    closest_exact,
    closest_walk,
    mesh_of,
    quadratic,
)
from synthgen.registration.scan import Scan
from synthgen.registration.solver import equations
from synthgen.registration.surface import Placed, Surface
from synthgen.registration.terms import Term

Array = NDArray[np.float64]
# Vertices are solved for to a hundredth of the least noise of a scanner.
TOLERANCE_M = 2e-6


# No scan is better than this.
LEAST_NOISE_M = 1e-4


@dataclass(frozen=True)
class CoupledSettings:
    """Of the coupled stage.

    Attributes
    ----------
    points, rounds : int
    follow : int
        How often the parameters follow the mesh in each round; 0: the model stays.
    edge_sd_m : float
        Standard deviation of the difference between an edge of V and of M, metres.
    offset_sd_m : float
        Loose tie of vertices to the model, which holds what no point sees.
    sigma_m, cut_m, cosine : float
        Of correspondences, as in :class:`synthgen.registration.schedule.Stage`.
    first : float
        The first round's scale and cut are wider by this factor.
    """

    points: int = 50_000
    rounds: int = 6
    follow: int = 2
    edge_sd_m: float = 7e-4
    offset_sd_m: float = 0.02
    sigma_m: float = 1e-3
    cut_m: float = 4e-3
    cosine: float = 0.5
    first: float = 1.0


# Bodies: the model's shape is farther from the skin, and following 52 joints costs more than it
# brings (the model is tracked by its own fit).
BODY = CoupledSettings(
    points=40_000, rounds=4, follow=0, edge_sd_m=1e-3, sigma_m=2e-3, cut_m=0.01, first=2.0
)


@dataclass(frozen=True, eq=False)
class Coupled:
    """Free vertices (V, 3), the parameters (n,) that follow them, and vertices with data (V,)."""

    vertices: Array
    x: Array
    seen: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class EdgeCoupling:
    """Edge coupling (Eq. 7): sum over edges of |e_V - e_M|^2 / sd^2, and the loose tie."""

    mesh: Topology
    laplacian: sparse.csr_matrix
    sd_m: float
    offset_sd_m: float

    def residual(self, free: Array, model: Array) -> Array:
        """Edge differences in standard deviations, (E, 3)."""
        i, j = self.mesh.edges.T
        off = free - model
        return np.asarray((off[i] - off[j]) / self.sd_m)

    def model_equations(self, placed: Placed) -> tuple[Array, Array]:
        """Return J^T C J (n, n) and J^T C (n, V, 3); C is the coupling's quadratic form."""
        jacobian = placed.jacobian
        v, _, n = jacobian.shape
        flat = jacobian.reshape(v, 3 * n)
        pull = self.laplacian @ flat / self.sd_m**2 + flat / self.offset_sd_m**2
        pull = pull.reshape(3 * v, n)
        return jacobian.reshape(3 * v, n).T @ pull, pull.T.reshape(n, v, 3)


@lru_cache(maxsize=8)
def edge_coupling(surface: Surface, sd_m: float, offset_sd_m: float = 0.02) -> EdgeCoupling:
    """Edges of a surface and their Laplacian."""
    mesh = mesh_of(surface)
    return EdgeCoupling(mesh, mesh.laplacian, sd_m, offset_sd_m)


def couple(
    surface: Surface,
    scan: Scan,
    x: Array,
    priors: Sequence[Term],
    noise_m: float | None = None,
    settings: CoupledSettings = CoupledSettings(),
) -> Coupled:
    """Free the mesh from the model, starting at a good fit x.

    ``noise_m`` is that of the points; None: the scan's own scatter, which knows of no misfit.
    """
    if noise_m is None:
        noise_m = max(scan.local_noise_m, LEAST_NOISE_M)
    mesh, placed = mesh_of(surface), surface.at(x)
    if not settings.follow:
        free, seen = freed(mesh, placed.vertices, scan, noise_m, settings)
        return Coupled(free, placed.x, seen)
    free, matches = placed.vertices.copy(), _Matches(mesh, scan, noise_m, settings)
    for _ in range(settings.rounds):
        problem = matches.beside(free)
        free, placed = _alternate(surface, placed, free, problem, priors, settings)
    return Coupled(free, placed.x, matches.seen)


def freed(
    mesh: Topology, model: Array, scan: Scan, noise_m: float, settings: CoupledSettings = BODY
) -> tuple[Array, NDArray[np.bool_]]:
    """Free a mesh from a model that stays: vertices (V, 3) and which have data (V,).

    ``model`` (V, 3), metres: the vertices of a good fit, of any model.
    """
    free, matches = np.array(model, dtype=np.float64), _Matches(mesh, scan, noise_m, settings)
    for _ in range(settings.rounds):
        free = matches.beside(free).solve(model, free, TOLERANCE_M)
    return free, matches.seen


class _Matches:
    """Closest points, renewed each round: the first search is exact, the others walk on."""

    def __init__(
        self, mesh: Topology, scan: Scan, noise_m: float, settings: CoupledSettings
    ) -> None:
        self.mesh, self.noise_m, self.settings = mesh, noise_m, settings
        self.points = np.ascontiguousarray(scan.points[: settings.points])
        self.normals = scan.normals[: settings.points]
        self.at: Closest | None = None
        self.seen = np.zeros(len(mesh.rim), dtype=bool)

    def beside(self, free: Array) -> Quadratic:
        """Match the points with a mesh and sum their distances from it."""
        s, wide = self.settings, self.settings.first if self.at is None else 1.0
        if self.at is None:
            self.at = closest_exact(self.mesh, free, self.points)
        else:
            self.at = closest_walk(self.mesh, free, self.points, self.at.corner(self.mesh))
        found = quadratic(
            self.mesh, free, self.points, self.normals, self.at, noise_m=self.noise_m,
            edge_sd_m=s.edge_sd_m, tie_sd_m=s.offset_sd_m, sigma_m=wide * s.sigma_m,
            cut_m=wide * s.cut_m, cosine=s.cosine,
        )  # fmt: skip
        self.seen[:] = False
        self.seen[self.mesh.faces[self.at.face[found.kept]].ravel()] = True
        return found


def _alternate(
    surface: Surface,
    placed: Placed,
    free: Array,
    problem: Quadratic,
    priors: Sequence[Term],
    settings: CoupledSettings,
) -> tuple[Array, Placed]:
    """Solve for the mesh beside the model, and for the linear model beside the mesh, in turn."""
    coupling = edge_coupling(surface, settings.edge_sd_m, settings.offset_sd_m)
    hessian, pull = coupling.model_equations(placed)
    slope = np.zeros(surface.n)
    for term in priors:
        for block in term.blocks(placed, term.match(placed)):
            own = equations(block)
            hessian += own[0]
            slope += own[1]
    hessian += 1e-9 * np.diag(hessian.diagonal())
    step, model = np.zeros(surface.n), placed.vertices
    for _ in range(settings.follow):
        free = problem.solve(model, free, TOLERANCE_M)
        right = np.tensordot(pull, free - placed.vertices, 2) - slope
        step = np.linalg.solve(hessian, right)
        model = placed.vertices + placed.jacobian @ step
    return free, surface.at(placed.x + step)
