"""The way back: hand coefficients from angles, and parameters from vertices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, ShapeError
from synthgen.geometry.rotations import axis_angle_from_matrix
from synthgen.models.hand_pca import finger_joints

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel, Hand

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
# A joint's own turn is guessed from vertices that it moves by at least this share.
_OWN = 0.5
_DAMPING_LIMITS = (1e-12, 1e8)


def pca_from_pose(
    model: BodyModel,
    pose: NDArray[Any],
    *,
    flat_hand_mean: bool,
    n: int | None = None,
    hand: Hand | None = None,
) -> tuple[Array, Array]:
    """Return the PCA coefficients of a hand that come closest to axis-angle poses.

    The published components are close to orthonormal but not exactly so; a transpose would miss
    by that much, least squares does not.

    Parameters
    ----------
    model : BodyModel
        With the pose space of that hand.
    pose : (B, K, 3) or (B, 45) float
        Of the whole model, or of the 15 finger joints alone; radians, mean included.
    flat_hand_mean : bool
        True if zero coefficients mean a flat hand, False if they mean ``hands_mean``.
    n : int or None
        Leading components used; None: all.
    hand : "left", "right" or None
        Which hand of a body; None: the only one of a hand model.

    Returns
    -------
    coefficients : (B, n) float64
    residual : (B,) float64
        Root mean square of what n components cannot express, radians.

    Raises
    ------
    ModelError
        If the model has no such pose space.
    ShapeError
        If the pose or ``n`` does not fit.
    """
    side = hand or model.hand
    space = None if side is None else model.hand_space(side)
    if side is None or space is None:
        raise ModelError(
            f"model {model.name!r} has no pose space of the {side or 'one'} hand; name a hand of a "
            "body, or load the file together with the MANO pair"
        )
    values = np.asarray(pose, dtype=np.float64)
    if values.ndim == 3:
        values = values[:, finger_joints(model, side)].reshape(len(values), -1)
    if values.ndim != 2 or values.shape[1] != len(space.mean):
        raise ShapeError(
            f"pose has shape {np.shape(pose)}; expected (B, {len(model.parents)}, 3) or (B, 45)"
        )
    rows = space.components[:n]
    if n is not None and not 1 <= n <= len(space.components):
        raise ShapeError(f"n={n}; the hand has 1 to {len(space.components)} components")
    wanted = values if flat_hand_mean else values - space.mean
    coefficients = np.linalg.lstsq(rows.T, wanted.T)[0].T
    left = wanted - coefficients @ rows
    return np.asarray(coefficients), np.asarray(np.sqrt(np.mean(left**2, axis=1)))


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
        If points, vertices or weights do not fit together.
    """
    rows, target, factor = _correspondences(model, points, vertex_ids, weights)
    counts = (
        model.n_shape if n_shape is None else min(n_shape, model.n_shape),
        model.n_pose,
        3,
        min(n_expression, model.n_expression),
    )
    x = _start(model, rows, target, factor, counts)
    damping, done, taken = 1e-3, False, 0
    residual, jacobian = _linearised(model, rows, target, factor, x, counts)
    penalty = np.full(len(x), prior * len(rows))
    penalty[counts[0] + counts[1] : sum(counts[:3])] = 0  # the translation is free
    cost = residual @ residual + penalty @ x**2
    while taken < steps and not done:
        taken += 1
        gradient = jacobian.T @ residual + penalty * x
        normal = jacobian.T @ jacobian + np.diag(penalty)
        for _ in range(12):
            scale = damping * np.maximum(normal.diagonal(), 1e-9)
            move = -np.linalg.solve(normal + np.diag(scale), gradient)
            trial, derivative = _linearised(model, rows, target, factor, x + move, counts)
            value = trial @ trial + penalty @ (x + move) ** 2
            if value <= cost:
                break
            damping = min(damping * 6, _DAMPING_LIMITS[1])
        else:
            done = True
            break
        done = bool(cost - value <= 1e-12 * cost or np.abs(move).max() < 1e-10)
        x, residual, jacobian, cost = x + move, trial, derivative, value
        damping = max(damping / 10, _DAMPING_LIMITS[0])
    return _result(model, rows, target, x, counts, taken, done)


def _result(
    model: BodyModel, rows: Ids, target: Array, x: Array, counts: Any, steps: int, done: bool
) -> VertexFit:
    shape, pose, move, psi = _split(model, x, counts)
    found = model.jacobian(shape, pose, move, psi if counts[3] else None, rows=rows).vertices
    away = np.linalg.norm(found - target, axis=1)
    rms = float(np.sqrt(np.mean(away**2)))
    return VertexFit(shape, pose, move, psi, rms, float(away.max()), steps, done)


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


def _split(model: BodyModel, x: Array, counts: Any) -> tuple[Array, Array, Array, Array]:
    ends = np.cumsum(counts)
    shape, pose, move, psi = np.split(x, ends[:-1])
    return shape, pose if model.axis_meta is not None else pose.reshape(-1, 3), move, psi


def _linearised(
    model: BodyModel, rows: Ids, target: Array, factor: Array, x: Array, counts: Any
) -> tuple[Array, Array]:
    shape, pose, move, psi = _split(model, x, counts)
    found = model.jacobian(shape, pose, move, psi if counts[3] else None, rows=rows)
    residual = (found.vertices - target) * factor[:, None]
    return residual.ravel(), (found.values * factor[:, None, None]).reshape(-1, len(x))


def _start(model: BodyModel, rows: Ids, target: Array, factor: Array, counts: Any) -> Array:
    """Mean shape, and joints turned as the points around them turned."""
    used = factor > 0
    rows, target = rows[used], target[used]
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
