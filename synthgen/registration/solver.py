"""Levenberg-Marquardt and dogleg on dense normal equations, correspondences renewed every step.

Both compare true costs (correspondences of the trial point), so a step is kept only if the robust
energy falls. Derivatives are made for accepted points only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.registration.body_kernels import normal_sums
from synthgen.registration.surface import Placed, Surface
from synthgen.registration.terms import Block, ScanToMesh, Term

Array = NDArray[np.float64]
Method = Literal["lm", "dogleg"]
MAX_TURN_RAD, MAX_TRIALS = 0.5, 4
SMALL_DROP, SMALL_DROPS = 1e-4, 2
# After many good steps the damping is nothing, and six times nothing would not shorten a bad one.
LEAST_REFUSED = 1e-3
# A point of a body moves with few of its parameters: from this many on rows are mostly zeros.
SPARSE_FROM = 100
CHUNK = 2048  # rows that stay in the cache


@dataclass(frozen=True, eq=False)
class Trial:
    """A parameter vector with its placed skin, matches and cost."""

    placed: Placed
    matches: tuple[Any, ...]
    cost: float


@dataclass(frozen=True, eq=False)
class Energy:
    """A sum of terms over one surface."""

    surface: Surface
    terms: Sequence[Term]

    def at(self, x: Array) -> Trial:
        """Match and price every term."""
        placed = self.surface.at(x)
        matches = tuple(term.match(placed) for term in self.terms)
        pairs = zip(self.terms, matches, strict=True)
        return Trial(placed, matches, sum(term.cost(placed, m) for term, m in pairs))

    def normal_equations(self, trial: Trial) -> tuple[Array, Array]:
        """Return J^T W J (n, n) and J^T W r (n,) at the trial's matches."""
        n = self.surface.n
        hessian, gradient = np.zeros((n, n)), np.zeros(n)
        for term, match in zip(self.terms, trial.matches, strict=True):
            whole = term.sums(trial.placed, match) if isinstance(term, ScanToMesh) else None
            if whole is not None:
                hessian, gradient = hessian + whole[0], gradient + whole[1]
                continue
            for block in term.blocks(trial.placed, match):
                own = equations(block)
                hessian, gradient = hessian + own[0], gradient + own[1]
        return hessian, gradient


def equations(block: Block) -> tuple[Array, Array]:
    """Return J^T W J (n, n) and J^T W r (n,) of a block of residuals."""
    n = block.rows.shape[1]
    hessian, gradient = np.zeros((n, n)), np.zeros(n)
    if n >= SPARSE_FROM:
        normal_sums(block.rows, block.weight, block.residual, hessian, gradient)
        return hessian + np.tril(hessian, -1).T, gradient
    for k in range(0, len(block.rows), CHUNK):
        part = slice(k, k + CHUNK)
        root = np.sqrt(block.weight[part])
        rows = block.rows[part] * root[:, None]
        hessian += rows.T @ rows
        gradient += rows.T @ (root * block.residual[part])
    return hessian, gradient


def gram(rows: Array, weight: Array) -> Array:
    """Return J^T W J (n, n) of rows (m, n) and weights (m,)."""
    return equations(Block(np.zeros(len(rows)), rows, weight))[0]


@dataclass(frozen=True, eq=False)
class Outcome:
    """Where a solver stopped: trial, steps taken, and why ("converged", "cap", "stuck")."""

    trial: Trial
    iterations: int
    reason: str

    @property
    def x(self) -> Array:
        """The parameter vector."""
        return self.trial.placed.x


def minimise(
    energy: Energy,
    x: Array,
    *,
    iterations: int,
    basis: Array | None = None,
    method: Method = "lm",
    damping: float = 1e-2,
) -> Outcome:
    """Lower an energy from x.

    Parameters
    ----------
    energy : Energy
    x : (n,) float64
    iterations : int
        Most steps.
    basis : (n, p) or None
        Directions to search, for example the columns of some joints or of a hand's principal
        components; None: all n.
    method : "lm" or "dogleg"
    damping : float
        First Marquardt parameter (lm).
    """
    trust = _Marquardt(damping) if method == "lm" else _Dogleg()
    trial, quiet = energy.at(x), 0
    for done in range(iterations):
        hessian, gradient = energy.normal_equations(trial)
        if basis is not None:
            hessian, gradient = basis.T @ hessian @ basis, basis.T @ gradient
        better = _accepted(energy, trial, hessian, gradient, basis, trust)
        if better is None:
            return Outcome(trial, done, "stuck")
        drop = (trial.cost - better.cost) / max(trial.cost, 1e-300)
        trial = better
        quiet = quiet + 1 if drop < SMALL_DROP else 0
        if quiet == SMALL_DROPS:
            return Outcome(trial, done + 1, "converged")
    return Outcome(trial, iterations, "cap")


def _accepted(
    energy: Energy, trial: Trial, hessian: Array, gradient: Array, basis: Array | None, trust: Any
) -> Trial | None:
    trust.prepare(hessian, gradient)
    for _ in range(MAX_TRIALS):
        step = trust.step()
        full = step if basis is None else basis @ step
        scale = min(1.0, MAX_TURN_RAD / max(np.abs(full[energy.surface.pose]).max(), 1e-12))
        tried = energy.at(wrapped(energy.surface, trial.placed.x + scale * full))
        if trust.judge(trial.cost - tried.cost, scale * step):
            return tried
        if promised(hessian, gradient, scale * step) < SMALL_DROP * trial.cost:
            return None  # shorter steps promise even less
    return None


def promised(hessian: Array, gradient: Array, step: Array) -> float:
    """How much lower the quadratic model is after a step."""
    return -float(2 * gradient @ step + step @ hessian @ step)


def wrapped(surface: Surface, x: Array) -> Array:
    """Return the same placement with angles of at most pi: the form is singular at 2 pi."""
    theta = x[surface.pose].reshape(-1, 3)
    angle = np.linalg.norm(theta, axis=1, keepdims=True)
    if angle.max() <= np.pi:
        return x
    turns = np.round(angle / (2 * np.pi))
    moved = theta - theta / np.maximum(angle, 1e-12) * (2 * np.pi * turns)
    result = x.copy()
    result[surface.pose] = moved.ravel()
    return result


class _Marquardt:
    """Damping in proportion to the diagonal: /4 after a good step, x6 after a bad one."""

    def __init__(self, damping: float) -> None:
        self.mu = damping

    def prepare(self, hessian: Array, gradient: Array) -> None:
        self.h, self.g = hessian, gradient
        diagonal = np.diag(hessian)
        self.scale = diagonal + 1e-6 * diagonal.max()

    def step(self) -> Array:
        return np.asarray(-np.linalg.solve(self.h + self.mu * np.diag(self.scale), self.g))

    def judge(self, gain: float, step: Array) -> bool:
        good = gain > 0
        self.mu = max(self.mu / 4, 1e-7) if good else max(self.mu, LEAST_REFUSED) * 6
        return good


class _Dogleg:
    """Powell's dogleg in variables scaled by the root of the diagonal."""

    def __init__(self) -> None:
        self.radius = np.inf

    def prepare(self, hessian: Array, gradient: Array) -> None:
        diagonal = np.diag(hessian)
        self.root = np.sqrt(diagonal + 1e-6 * diagonal.max())
        self.h = hessian / np.outer(self.root, self.root)
        self.g = gradient / self.root
        self.newton = -np.linalg.solve(self.h + 1e-9 * np.eye(len(self.g)), self.g)
        along = float(self.g @ self.h @ self.g)
        self.cauchy = -(self.g @ self.g) / max(along, 1e-300) * self.g
        if not np.isfinite(self.radius):
            self.radius = float(np.linalg.norm(self.newton))

    def step(self) -> Array:
        if np.linalg.norm(self.newton) <= self.radius:
            path = self.newton
        elif (length := float(np.linalg.norm(self.cauchy))) >= self.radius:
            path = self.cauchy * (self.radius / length)
        else:
            leg = self.newton - self.cauchy
            a, b = leg @ leg, self.cauchy @ leg
            c = self.cauchy @ self.cauchy - self.radius**2
            path = self.cauchy + (-b + np.sqrt(b * b - a * c)) / a * leg
        return np.asarray(path / self.root)

    def judge(self, gain: float, step: Array) -> bool:
        scaled = step * self.root
        ratio = gain / max(promised(self.h, self.g, scaled), 1e-300)
        if ratio < 0.25:
            self.radius = 0.25 * float(np.linalg.norm(scaled))
        elif ratio > 0.75:
            self.radius = max(self.radius, 2 * float(np.linalg.norm(scaled)))
        return gain > 0
