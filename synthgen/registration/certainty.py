"""How well a fit knows its parameters: the covariance of where a robust energy is lowest.

The inverse Hessian of the last step is too sure of itself, the more the noisier the scan, for
three reasons. A robust weight falls with the distance, so that the energy is flatter than its
weights say. The direction in which a point pulls is the normal at its closest point, which moves
with the skin: of a finger turned about its bone, noise remembers less than the normals promise.
And a prior is only as right as its poses are like this one. So the covariance is the sandwich
``A^-1 B A^-1`` of M-estimators (Huber 1981): A is the slope of the gradient, B its variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import unit
from synthgen.registration.correspondences import Pairs
from synthgen.registration.solver import Energy, Trial, gram
from synthgen.registration.surface import Placed
from synthgen.registration.terms import Block, MeshToScan, MixturePrior, ScanToMesh

Array = NDArray[np.float64]
# Points whose rows are looked at, and of these those whose normals are differentiated.
POINTS, TURNING = 10_000, 2_500
# On flat triangles with interpolated normals closest points move farther than on smooth skin: the
# loss of slope is twice what turning normals say (finite differences of the gradient, 1 mm noise).
FLAT = 2.0
# What is left of a direction's certainty at least, of what the weights say: where points and
# turning normals nearly cancel, the slope beside the minimum is steeper than in it.
LEAST = 0.25
# A prior's variance is scaled up to what was found, in so many rounds, at most by so much. Hand
# poses that the mixture never saw lie farther off than its components say, most of all in the
# directions in which they are narrow and in which, therefore, they matter: 1.6 times
# at 0.2 mm noise, 2.4 at 1 mm (capture protocol, 4 degrees beside it).
ROUNDS, MOST, FOREIGN = 3, 9.0, 2.4


@dataclass
class _Sums:
    """Normal matrices (n, n): by weights, of the gradient's slope, of its variance."""

    weighed: Array
    slope: Array
    spread: Array


@dataclass(frozen=True, eq=False)
class _Held:
    """A prior in its own standard deviations: residuals (m,), rows (m, n), and its least scale."""

    residual: Array
    rows: Array
    least: float

    def scale(self, covariance: Array) -> float:
        """By how much its variance is too small for what was found, as EM would estimate it."""
        if len(self.rows) == 0:
            return self.least
        known = np.sum(self.residual**2) + np.sum((self.rows @ covariance) * self.rows)
        return float(np.clip(known / len(self.rows), self.least, MOST))


@dataclass(frozen=True, eq=False)
class Earlier:
    """Parameters that were fitted before, and held since.

    Attributes
    ----------
    columns : slice
        Where they lie in the vector.
    basis : (n, p)
        Directions that were free then: to the first data term and the priors.
    """

    columns: slice
    basis: Array


def covariance(
    energy: Energy,
    trial: Trial,
    *,
    basis: Array | None = None,
    together: float | Sequence[float] = 1.0,
    earlier: Earlier | None = None,
) -> Array:
    """Return the covariance (n, n) of the parameters at a minimum.

    Parameters
    ----------
    energy : Energy
        Data terms and priors.
    trial : Trial
        The minimum, with its matches.
    basis : (n, p) or None
        Directions that were free; the others are known.
    together : float or one of each data term
        How many points err as one: 1 for independent noise.
    earlier : Earlier or None
        What is not free, and not known either.
    """
    n = energy.surface.n
    data: list[_Sums] = []
    held: list[_Held] = []
    for term, match in zip(energy.terms, trial.matches, strict=True):
        if isinstance(term, (ScanToMesh, MeshToScan)):
            data.append(_Sums(*np.zeros((3, n, n))))
            if isinstance(term, MeshToScan):
                _add_blocks(data[-1], term.blocks(trial.placed, match))
            else:
                alike = together if isinstance(together, float) else together[len(data) - 1]
                _add_points(data[-1], term, trial.placed, match, alike)
        else:
            least = FOREIGN if isinstance(term, MixturePrior) else 1.0
            held += [_held(b, least) for b in term.blocks(trial.placed, match)]
    prior = _weighted(held, np.ones(len(held)), n)
    answers = _answers(data, prior, np.eye(n) if basis is None else basis, earlier)
    scales = np.array([one.least for one in held])
    for _ in range(ROUNDS if held else 1):
        found = answers[0] @ _weighted(held, scales, n) @ answers[0].T
        for sums, answer in zip(data, answers[1:], strict=True):
            found += answer @ sums.spread @ answer.T
        scales = np.array([one.scale(found) for one in held])
    return np.asarray(found)


def _answers(
    data: Sequence[_Sums], prior: Array, free: Array, earlier: Earlier | None
) -> list[Array]:
    """By how much (n, n) the parameters give way to the pull of the priors and of each data term.

    What was fitted earlier has answered to the first data term and the priors; the rest follows it.
    """
    n = len(prior)
    slope = sum((one.slope for one in data), prior)
    last = _inverse(slope, sum((one.weighed for one in data), prior), free)
    if earlier is None or not data:
        return [last] * (1 + len(data))
    first = _inverse(data[0].slope + prior, data[0].weighed + prior, earlier.basis)
    following = (np.eye(n) - last @ slope)[:, earlier.columns]
    both = last + following @ first[earlier.columns]
    return [both, both, *[last] * (len(data) - 1)]


def _held(block: Block, least: float) -> _Held:
    root = np.sqrt(block.weight)
    return _Held(root * block.residual, root[:, None] * block.rows, least)


def _weighted(held: Sequence[_Held], scales: Array, n: int) -> Array:
    total = np.zeros((n, n))
    for one, scale in zip(held, scales, strict=True):
        total += scale * one.rows.T @ one.rows
    return total


def _inverse(slope: Array, weighed: Array, free: Array) -> Array:
    """Invert the slope (n, n) along free directions (n, p).

    In no direction is it less than a part of what the weights say.
    """
    slope, weighed = free.T @ slope @ free, free.T @ weighed @ free
    n = len(weighed)
    low = np.linalg.cholesky(weighed + 1e-12 * np.trace(weighed) / n * np.eye(n))
    root = np.linalg.inv(low)
    values, vectors = np.linalg.eigh(root @ slope @ root.T)
    turned = vectors.T @ root @ free.T
    return np.asarray(turned.T @ (turned / np.maximum(values, LEAST)[:, None]))


def _add_blocks(sums: _Sums, blocks: Sequence[Block]) -> None:
    for block in blocks:
        known = gram(block.rows, block.weight)
        sums.weighed += known
        sums.slope += known
        sums.spread += gram(block.rows, (block.weight * block.residual) ** 2)


def _add_points(
    sums: _Sums, term: ScanToMesh, placed: Placed, match: Pairs, together: float
) -> None:
    """Add what points say along the normals; a part of them stands for all."""
    some = slice(0, POINTS)
    triangle, b, normal = match.triangle[some], match.barycentric[some], match.normal[some]
    squared = match.squared[some]
    foot = np.einsum("mk,mka->ma", b, placed.vertices[triangle]) + match.shift[some]
    residual = np.sum((foot - term.points[some]) * normal, axis=1)
    w = term.point_weights(match, some) * len(match.squared) / max(len(squared), 1)
    used = np.flatnonzero(w > 1e-4 * w.max(initial=0.0))
    triangle, b, normal = triangle[used], b[used], normal[used]
    w, residual, squared = w[used], residual[used], squared[used]
    rows = placed.rows(triangle, b, normal)
    known = gram(rows, w)
    sums.weighed += known
    falling = w * (1 - 4 * squared / (term.rho.sigma_m**2 + squared))
    sums.slope += known * (falling.sum() / max(w.sum(), 1e-300))
    part = min(POINTS / max(len(match.squared), 1), 1.0)
    sums.spread += gram(rows, part * together * (w * residual) ** 2)
    few = slice(0, TURNING)
    turning, bend = normal_rows(placed, triangle[few], b[few], normal[few])
    # Within a radius of curvature; farther off, the closest point leaps to other skin.
    off = residual[few] ** 2
    pull = FLAT * w[few] * off / (1 + bend**2 * off) * max(len(used) / TURNING, 1.0)
    sums.slope -= gram(turning, np.repeat(pull, 2))


def normal_rows(
    placed: Placed, triangle: NDArray[np.int64], barycentric: Array, normal: Array
) -> tuple[Array, Array]:
    """Differentiate the normals at the points of skin nearest to fixed points.

    A normal turns with its triangle, and changes as the skin slides past below the point.

    Returns
    -------
    rows : (2 m, n)
        Along two directions of each tangent plane.
    bend : (m,)
        How strongly the skin bends there, per metre.
    """
    slopes = _barycentric_slopes(placed.vertices[triangle])
    bent, bend = placed.normals[triangle], np.zeros(len(triangle))
    result = np.empty((2 * len(triangle), placed.surface.n))
    for k, along in enumerate(_tangents(normal)):
        gradient = np.einsum("mka,ma->mk", slopes, along)
        turned = placed.rows(triangle, gradient, normal)
        turned[:, placed.surface.translation] = 0  # gradients of barycentrics sum to zero
        passed = np.einsum("mk,mka->ma", np.einsum("mka,ma->mk", bent, along), slopes)
        bend += np.sum(passed**2, axis=1)
        result[k::2] = -turned - placed.rows(triangle, barycentric, passed)
    return result, np.sqrt(bend)


def _barycentric_slopes(corner: Array) -> Array:
    """Gradients (m, 3, 3) of the barycentric coordinates within triangles (m, 3, 3)."""
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    double = np.maximum(np.sum(across**2, axis=1), 1e-30)[:, None, None]
    opposite = corner[:, [2, 0, 1]] - corner[:, [1, 2, 0]]
    return np.asarray(np.cross(across[:, None], opposite) / double)


def _tangents(normal: Array) -> tuple[Array, Array]:
    """Two directions (m, 3) across each normal."""
    first = unit(np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)]))
    return first, np.cross(normal, first)
