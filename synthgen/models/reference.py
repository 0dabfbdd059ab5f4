"""The equations of every family in float64, one sample at a time: what the kernels must equal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models.arguments import checked
from synthgen.models.pose_features import feature_joints, rotations_and_features

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]


def evaluate_reference(
    model: BodyModel, shape: Any, pose: Any, translation: Any = None, expression: Any = None
) -> tuple[Array, Array]:
    """Return vertices (B, V, 3) and joints (B, K, 3); arguments as ``BodyModel.evaluate``."""
    given = checked(model, shape, pose, translation, expression)
    rotations, features = rotations_and_features(model, given.pose)
    rows = zip(given.shape, given.expression, rotations, features, given.translation, strict=True)
    results = [_one(model, *row) for row in rows]
    return np.array([v for v, _ in results]), np.array([j for _, j in results])


def rest(model: BodyModel, shape: Any, expression: Any = None) -> tuple[Array, Array]:
    """Return rest-pose vertices (V, 3) and joints (K, 3) of betas (nb,) and expression (ne,)."""
    beta = np.asarray(shape, dtype=np.float64)
    vertices = model.v_template + model.shapedirs[..., : len(beta)] @ beta
    psi = np.zeros(0) if expression is None else np.asarray(expression, dtype=np.float64)
    if model.exprdirs is not None:
        vertices = vertices + model.exprdirs[..., : len(psi)] @ psi
    return vertices, _joints(model, vertices, beta, psi)


def _joints(model: BodyModel, shaped: Array, beta: Array, psi: Array) -> Array:
    basis = model.joint_basis
    if basis is not None:
        of_shape = basis[1 : 1 + len(beta)]
        of_expression = basis[1 + model.n_shape : 1 + model.n_shape + len(psi)]
        moved = np.tensordot(beta, of_shape, 1) + np.tensordot(psi, of_expression, 1)
        return np.asarray(basis[0] + moved)
    if model.family == "supr":
        affine = model.J_regressor
        return np.asarray(affine[:, :-1] @ shaped.ravel() + affine[:, -1]).reshape(-1, 3)
    return model.J_regressor @ shaped


def _one(
    model: BodyModel, beta: Array, psi: Array, rotation: Array, features: Array, moved: Array
) -> tuple[Array, Array]:
    shaped, joints = rest(model, beta, psi)
    feature = features[feature_joints(model)[0] :].ravel()
    if model.family == "star":
        feature = np.append(feature, beta[1] if len(beta) > 1 else 0.0)
    posed = shaped + model.posedirs @ feature
    turn, place = [rotation[0]], [joints[0]]
    for k in range(1, len(rotation)):
        p = model.parents[k]
        turn.append(turn[p] @ rotation[k])
        place.append(place[p] + turn[p] @ (joints[k] - joints[p]))
    vertices = np.zeros_like(posed)
    for k, (r, t) in enumerate(zip(turn, place, strict=True)):
        vertices += model.weights[:, k, None] * ((posed - joints[k]) @ r.T + t)
    return vertices + moved, np.array(place) + moved
