"""The terms of the energy (Embodied Hands, Eq. 5-9, 13-21), each with its residual and Jacobian.

Every term is ``sum_i w_i r_i(x)^2`` near a point x: it first *matches* (finds correspondences and
robust weights, frozen inside one step), then hands out a :class:`Block` with rows of dr/dx. Its
``cost`` is the true, robust cost; rejected correspondences cost the plateau, so that no step wins
by losing points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from synthgen.registration.correspondences import Pairs, closest, ramp
from synthgen.registration.mesh_sums import summed
from synthgen.registration.scan import Scan, nearest
from synthgen.registration.surface import Placed, Surface

Array = NDArray[np.float64]
Where = slice | NDArray[np.int64]
LEAST_INSIDE = 0.5  # share of points that a sound placement has within an open rim


@dataclass(frozen=True, eq=False)
class Block:
    """Residuals (m,), their derivatives (m, n) and weights (m,) at a frozen match."""

    residual: Array
    rows: Array
    weight: Array


class Term(Protocol):
    """One summand of the energy."""

    def match(self, placed: Placed) -> Any:
        """Find what stays fixed inside a step."""

    def cost(self, placed: Placed, match: Any) -> float:
        """Return the robust cost."""

    def blocks(self, placed: Placed, match: Any) -> list[Block]:
        """Linearise the residuals at a match."""


@dataclass(frozen=True)
class GemanMcClure:
    """rho(d) = s^2 d^2 / (s^2 + d^2) (Eq. 6): the plateau is s^2."""

    sigma_m: float

    def cost(self, squared: Array, trust: Array) -> Array:
        """Cost (m,) of squared distances; the plateau where a pair is not trusted (0..1)."""
        s2 = self.sigma_m**2
        return s2 * (1 - trust * s2 / (s2 + squared))

    def weight(self, squared: Array, trust: Array) -> Array:
        """Weight (m,) of iterated least squares, d rho / d(d^2); 0 where not trusted."""
        s2 = self.sigma_m**2
        return trust * (s2 / (s2 + squared)) ** 2


@dataclass(frozen=True, eq=False)
class ScanToMesh:
    """Point-to-plane distance of scan points from the mesh (Eq. 6, 14), sliding allowed.

    Attributes
    ----------
    points, normals : (m, 3)
        The subsample.
    weight : float
        Of the whole sum, per metre^2 of mean cost.
    rho : GemanMcClure
    cut_m : float
        Largest distance of a correspondence, metres.
    cosine : float
        Smallest cosine between the normals of scan and mesh.
    tangential : float
        Share of the point-to-point distance added, which ties down sliding far from the optimum.
    curved : float
        See :func:`closest`.
    tied : int or None
        Points that carry the tangential part, for all; None: each its own.
    memory : dict or None
        Where the last match's points lay, for a stage whose steps are small: the first match
        searches, the others walk on from there.
    """

    points: Array
    normals: Array
    weight: float
    rho: GemanMcClure
    cut_m: float
    cosine: float
    tangential: float = 0.0
    curved: float = 0.0
    tied: int | None = None
    memory: dict[str, NDArray[np.int64]] | None = None

    def match(self, placed: Placed) -> Pairs:
        """Find closest points."""
        start = None if self.memory is None else self.memory.get("corner")
        found = closest(
            placed,
            self.points,
            self.normals,
            cut_m=self.cut_m,
            cosine=self.cosine,
            curved=self.curved,
            start=start,
        )
        if self.memory is not None:
            self.memory["corner"] = found.corner
        return found

    def cost(self, placed: Placed, match: Pairs) -> float:
        """Return the weighted mean robust cost of the points within the rim.

        Those beyond it (a wrist's, a neck's) say nothing: were they to cost anything, the rim
        would be pulled over them. But where most points are beyond it, the others' cost is the
        plateau's.
        """
        inside, most = float(match.inner.sum()), len(match.inner) * LEAST_INSIDE
        total = float(match.inner @ self.rho.cost(match.squared, match.trust))
        total += max(most - inside, 0.0) * self.rho.sigma_m**2
        return self.weight * total / max(inside, most)

    def point_weights(self, match: Pairs, some: slice = slice(None)) -> Array:
        """Return the weights (m,) of the points' squared distances."""
        inside = max(float(match.inner.sum()), len(match.inner) * LEAST_INSIDE)
        robust = self.rho.weight(match.squared[some], match.trust[some])
        return self.weight / max(inside, 1.0) * match.inner[some] * robust

    def sums(self, placed: Placed, match: Pairs) -> tuple[Array, Array] | None:
        """Return J^T W J and J^T W r at once, where points are so many that this is cheaper."""
        if self.tangential > 0 or len(self.points) < placed.surface.summed_from:
            return None
        return summed(placed, match, self.points, self.point_weights(match))

    def blocks(self, placed: Placed, match: Pairs) -> list[Block]:
        """Rows n . sum b dv/dx; with ``tangential`` also the three coordinates."""
        w = self.point_weights(match)
        used = np.flatnonzero(w > 1e-4 * w.max(initial=0.0))
        t, b, w = match.triangle[used], match.barycentric[used], w[used]
        corner = placed.vertices[t]
        offset = np.einsum("mk,mka->ma", b, corner) + match.shift[used] - self.points[used]
        blocks = [
            Block(np.sum(offset * match.normal[used], axis=1),
                  placed.rows(t, b, match.normal[used]), w)
        ]  # fmt: skip
        some = slice(0, self.tied)
        t, b, share = t[some], b[some], len(used) / max(len(t[some]), 1)
        for axis in range(3 if self.tangential > 0 else 0):
            along = np.tile(np.eye(3)[axis], (len(t), 1))
            rows = placed.rows(t, b, along)
            blocks.append(Block(offset[some, axis], rows, self.tangential * share * w[some]))
        return blocks


@dataclass(frozen=True, eq=False)
class MeshToScan:
    """Distance of visible mesh vertices from the scan (Eq. 15), along the scan's normals.

    ``visible`` (V,) says which vertices the sensors could see, where that is known; rim vertices
    and vertices over holes (farther than ``cut_m``) are left out at the plateau. ``some`` (m,) are
    the vertices looked at (bodies), None: all.
    """

    scan: Scan
    weight: float
    rho: GemanMcClure
    cut_m: float
    cosine: float
    visible: NDArray[np.bool_] | None = None
    some: NDArray[np.int64] | None = None

    def match(self, placed: Placed) -> tuple[NDArray[np.int64], Array, Array]:
        """Nearest scan points, squared distances, and how far pairs are trusted (0..1)."""
        own = slice(None) if self.some is None else self.some
        distance, near = nearest(self.scan.tree, placed.vertices[own])
        facing = np.sum(placed.normals[own] * self.scan.normals[near], axis=1)
        used = (distance < self.cut_m) & ~placed.surface.rim[own]
        if self.visible is not None:
            used &= self.visible[own]
        return near, distance**2, np.where(used, ramp(facing, self.cosine), 0)

    def cost(self, placed: Placed, match: Any) -> float:
        """Return the weighted mean robust cost."""
        return self.weight * float(self.rho.cost(match[1], match[2]).mean())

    def blocks(self, placed: Placed, match: Any) -> list[Block]:
        """Rows n_scan . dv/dx."""
        near, squared, trust = match
        w = self.weight / len(squared) * self.rho.weight(squared, trust)
        used = np.flatnonzero(w)
        normal = self.scan.normals[near[used]]
        ids = used if self.some is None else self.some[used]
        residual = np.sum((placed.vertices[ids] - self.scan.points[near[used]]) * normal, axis=1)
        return [Block(residual, placed.vertex_rows(ids, normal), w[used])]


def _constant_rows(n: int, where: Where, rows: Array) -> Array:
    full = np.zeros((len(rows), n))
    full[:, where] = rows
    return full


@dataclass(frozen=True, eq=False)
class MixturePrior:
    """Hand pose prior: the best component of a Gaussian mixture (Eq. 17-19, max approximation).

    Attributes
    ----------
    where : slice
        The hand's 45 angles in the vector.
    means : (k, 45), whiten : (k, 45, 45), constants : (k,)
        Residual ``whiten (h - mean)``; constants are -log weight + log det / 2, lowest zero.
    """

    where: slice
    means: Array
    whiten: Array
    constants: Array
    weight: float = 1.0

    def match(self, placed: Placed) -> int:
        """Return the component of least energy."""
        off = np.einsum("kab,kb->ka", self.whiten, placed.x[self.where] - self.means)
        return int(np.argmin(self.constants + 0.5 * np.sum(off**2, axis=1)))

    def cost(self, placed: Placed, match: int) -> float:
        """Return twice the negative log of the component."""
        off = self.whiten[match] @ (placed.x[self.where] - self.means[match])
        return self.weight * float(2 * self.constants[match] + off @ off)

    def blocks(self, placed: Placed, match: int) -> list[Block]:
        """Whitened offsets from the component's mean."""
        residual = self.whiten[match] @ (placed.x[self.where] - self.means[match])
        rows = _constant_rows(placed.surface.n, self.where, self.whiten[match])
        return [Block(residual, rows, np.full(len(residual), self.weight))]


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """Independent normals: shape (Eq. 9), a protocol's pose, zero velocity (Eq. 21).

    ``mean`` (m,) and ``sd`` (m,) in the parameters' units; the previous frame's pose as mean makes
    it the zero-velocity term.
    """

    where: Where
    mean: Array
    sd: Array
    weight: float = 1.0

    def match(self, placed: Placed) -> None:
        """Nothing to find."""

    def cost(self, placed: Placed, match: None) -> float:
        """Return the Mahalanobis distance squared."""
        return self.weight * float(np.sum(((placed.x[self.where] - self.mean) / self.sd) ** 2))

    def blocks(self, placed: Placed, match: None) -> list[Block]:
        """Offsets in standard deviations."""
        residual = (placed.x[self.where] - self.mean) / self.sd
        rows = _constant_rows(placed.surface.n, self.where, np.diag(1 / self.sd))
        return [Block(residual, rows, np.full(len(residual), self.weight))]


def shape_prior(surface: Surface, weight: float = 1.0) -> GaussianPrior:
    """Mahalanobis distance of the betas (Eq. 9)."""
    nb = surface.model.n_shape
    return GaussianPrior(surface.shape, np.zeros(nb), np.ones(nb), weight)


def velocity_prior(where: Where, previous: Array, sd_rad: Array) -> GaussianPrior:
    """Zero-velocity term (Eq. 21): some angles stay at the previous frame's, each with its sd."""
    return GaussianPrior(where, previous[where].copy(), sd_rad)


@dataclass(frozen=True, eq=False)
class KeypointTerm:
    """Distances of joints from known 3-D keypoints (m, 3), metres, sd ``sd_m``; optional."""

    joints: NDArray[np.int64]
    keypoints: Array
    sd_m: float

    def match(self, placed: Placed) -> None:
        """Nothing to find."""

    def cost(self, placed: Placed, match: None) -> float:
        """Return squared distances in standard deviations."""
        return float(np.sum(((placed.joints[self.joints] - self.keypoints) / self.sd_m) ** 2))

    def blocks(self, placed: Placed, match: None) -> list[Block]:
        """Three rows a joint."""
        residual = ((placed.joints[self.joints] - self.keypoints) / self.sd_m).ravel()
        rows = placed.joint_jacobian[self.joints].reshape(-1, placed.surface.n) / self.sd_m
        return [Block(residual, rows, np.ones(len(residual)))]
