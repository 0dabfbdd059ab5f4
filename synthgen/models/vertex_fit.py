"""Parameters of a model from vertices whose points are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import axis_angle_from_matrix

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
# A joint's own turn is guessed from vertices that it moves by at least this share.
_OWN = 0.5
_DAMPING_LIMITS = (1e-12, 1e8)
_TRIES = 12


@dataclass(frozen=True, eq=False)
class VertexFit:
    """Parameters that bring a model's vertices onto given points.

    Attributes
    ----------
    shape : (n_shape,)
    pose : (K, 3), or (P,) of a constrained model
        Radians, mean included.
    translation : (3,) metres
    expression : (n_expression,)
    rms_m, worst_m : float
        Distance between vertices and points, root mean square and largest.
    steps : int
        Gauss-Newton steps taken.
    converged : bool
        Whether the last step changed nothing that matters.
    """

    shape: Array
    pose: Array
    translation: Array
    expression: Array
    rms_m: float
    worst_m: float
    steps: int
    converged: bool


def fit_vertices(
    model: BodyModel,
    points: NDArray[Any],
    vertex_ids: NDArray[Any] | None = None,
    *,
    weights: NDArray[Any] | None = None,
    n_shape: int | None = None,
    n_expression: int = 0,
    prior: float = 1e-14,
    steps: int = 60,
) -> VertexFit:
    """Fit shape, pose and translation to points whose vertices are known.

    Damped Gauss-Newton with the analytic Jacobian, from a start that turns every joint as the
    points around it turned (Kabsch), so that large poses are found too. For points without
    correspondences use ``synthgen.registration``.

    Parameters
    ----------
    model : BodyModel
    points : (m, 3) float, metres
    vertex_ids : (m,) int or None
        The vertex that each point belongs to; None: all of them, in order.
    weights : (m,) float or None
        Of each point, not negative; None: all 1.
    n_shape, n_expression : int
        Coefficients that are fitted; None: all of the shape.
    prior : float
        Weight of squared coefficients and angles against squared metres: it decides what the
        points leave open and is too small to be seen elsewhere.
    steps : int
        At most.

    Returns
    -------
    VertexFit

    Raises
    ------
    ShapeError
        If points, vertices or weights do not fit together, or a number is negative.
    """
    rows, target, factor = _correspondences(model, points, vertex_ids, weights)
    if min(0 if n_shape is None else n_shape, n_expression, steps) < 0:
        raise ShapeError(
            f"n_shape={n_shape}, n_expression={n_expression}, steps={steps}: none may be negative"
        )
    counts = (
        model.n_shape if n_shape is None else min(n_shape, model.n_shape),
        model.n_pose,
        3,
        min(n_expression, model.n_expression),
    )
    problem = _Problem(model, rows, target, factor, counts, prior * len(rows))
    x, taken, done = _minimised(problem, _start(problem), steps)
    return _result(problem, x, taken, done)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Squared distances of ``rows`` to ``target``, weighted, plus a weak pull towards zero.

    Unknowns are shape, pose, translation and expression, as many as ``counts`` says.
    """

    model: BodyModel
    rows: Ids
    target: Array
    factor: Array
    counts: tuple[int, int, int, int]
    pull: float

    def split(self, x: Array) -> tuple[Array, Array, Array, Array | None]:
        shape, pose, move, psi = np.split(x, np.cumsum(self.counts)[:-1])
        pose = pose if self.model.axis_meta is not None else pose.reshape(-1, 3)
        return shape, pose, move, psi if self.counts[3] else None

    def linearised(self, x: Array) -> tuple[Array, Array]:
        """Return residuals (3 m,) and their derivatives (3 m, len(x))."""
        found = self.model.jacobian(*self.split(x), rows=self.rows)
        residual = (found.vertices - self.target) * self.factor[:, None]
        return residual.ravel(), (found.values * self.factor[:, None, None]).reshape(-1, len(x))

    @property
    def penalty(self) -> Array:
        """Weight of each squared unknown; the translation is free."""
        shape, pose, move, psi = self.counts
        free = np.concatenate([np.ones(shape + pose), np.zeros(move), np.ones(psi)])
        return self.pull * free


def _minimised(problem: _Problem, x: Array, steps: int) -> tuple[Array, int, bool]:
    """Take damped Gauss-Newton steps (Levenberg-Marquardt) until nothing changes."""
    penalty, damping = problem.penalty, 1e-3
    residual, jacobian = problem.linearised(x)
    cost = residual @ residual + penalty @ x**2
    for taken in range(1, steps + 1):
        gradient = jacobian.T @ residual + penalty * x
        normal = jacobian.T @ jacobian + np.diag(penalty)
        for _ in range(_TRIES):
            scale = damping * np.maximum(normal.diagonal(), 1e-9)
            move = -np.linalg.solve(normal + np.diag(scale), gradient)
            trial, derivative = problem.linearised(x + move)
            value = trial @ trial + penalty @ (x + move) ** 2
            if value <= cost:
                break
            damping = min(damping * 6, _DAMPING_LIMITS[1])
        else:  # no step is better: this is the minimum, as far as numbers go
            return x, taken, True
        settled = bool(cost - value <= 1e-12 * cost or np.abs(move).max() < 1e-10)
        x, residual, jacobian, cost = x + move, trial, derivative, value
        if settled:
            return x, taken, True
        damping = max(damping / 10, _DAMPING_LIMITS[0])
    return x, steps, False


def _result(problem: _Problem, x: Array, steps: int, done: bool) -> VertexFit:
    shape, pose, move, psi = problem.split(x)
    found = problem.model.jacobian(shape, pose, move, psi, rows=problem.rows).vertices
    away = np.linalg.norm(found - problem.target, axis=1)
    rms = float(np.sqrt(np.mean(away**2)))
    expression = np.zeros(0) if psi is None else psi
    return VertexFit(shape, pose, move, expression, rms, float(away.max()), steps, done)


def _correspondences(
    model: BodyModel, points: Any, vertex_ids: Any, weights: Any
) -> tuple[Ids, Array, Array]:
    target = np.asarray(points, dtype=np.float64)
    v = len(model.v_template)
    rows = np.arange(v) if vertex_ids is None else np.asarray(vertex_ids)
    if target.ndim != 2 or target.shape[1] != 3 or len(target) != len(rows) or len(rows) < 4:
        raise ShapeError(
            f"points are {target.shape} for {len(rows)} vertices; expected (m, 3) with one vertex "
            "each, m at least 4"
        )
    if not np.isfinite(target).all():
        raise ShapeError("points hold NaN or infinity; leave those points out")
    if rows.dtype.kind not in "iu" or rows.min() < 0 or rows.max() >= v:
        raise ShapeError(f"vertex_ids must be whole numbers 0 to {v - 1}")
    given = np.ones(len(rows)) if weights is None else np.asarray(weights, dtype=np.float64)
    if given.shape != (len(rows),) or not (given >= 0).all() or not np.isfinite(given).all():
        raise ShapeError(f"weights must be {len(rows)} numbers that are not negative")
    return rows.astype(np.int64), target, np.sqrt(given)


def _start(problem: _Problem) -> Array:
    """Return the mean shape with joints turned as the points around them turned."""
    model, counts, used = problem.model, problem.counts, problem.factor > 0
    rows, target = problem.rows[used], problem.target[used]
    rest, weights = model.v_template[rows], model.weights[rows]
    turns = np.zeros((len(model.parents), 3, 3))
    turns[0] = _kabsch(rest, target)
    owners = weights.argmax(axis=1)
    for k, parent in enumerate(model.parents[1:], start=1):
        own = (owners == k) & (weights[:, k] >= _OWN)
        turns[k] = _kabsch(rest[own], target[own]) if own.sum() >= 4 else turns[parent]
    local = turns.copy()
    local[1:] = np.swapaxes(turns[model.parents[1:]], -1, -2) @ turns[1:]
    pose = axis_angle_from_matrix(local)
    if model.axis_meta is not None:
        flat = np.zeros(counts[1])
        root = model.axis_meta.order[0]
        if root < len(model.axis_meta.spherical):
            flat[model.axis_meta.spherical[root]] = pose[0]
        pose = flat
    start = np.zeros((1, counts[0]))
    at = model.evaluate(start, pose[None]).vertices[0, rows]
    move = (target - at).mean(axis=0)
    return np.concatenate([start[0], pose.ravel(), move, np.zeros(counts[3])])


def _kabsch(source: Array, target: Array) -> Array:
    """Return the rotation that best takes centred points onto centred points."""
    covariance = (source - source.mean(axis=0)).T @ (target - target.mean(axis=0))
    u, _, vt = np.linalg.svd(covariance)
    sign = np.sign(np.linalg.det(vt.T @ u.T))
    result: Array = vt.T @ np.diag([1.0, 1.0, sign]) @ u.T
    return result
