"""The Jacobian by the product rule, one parameter at a time, in float64 NumPy.

Slow and readable: what :mod:`synthgen.models.jacobian_kernels` must equal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.rotations import cross_matrix
from synthgen.models.arguments import checked
from synthgen.models.chain import chain, skinning_transforms
from synthgen.models.packed import fold_joints, shape_directions
from synthgen.models.pose_features import feature_joints, rotations_and_features
from synthgen.models.pose_tangents import tangents
from synthgen.models.reference import rest

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]


def jacobian_reference(model: BodyModel, shape: Any, pose: Any, expression: Any = None) -> Array:
    """Return d vertices / d (shape, pose, translation, expression), (V, 3, D), of one sample.

    ``shape`` (nb,), ``pose`` (K, 3), (K, 3, 3) or (P,), ``expression`` (ne,) or None.
    """
    beta, psi = np.asarray(shape), np.zeros(0) if expression is None else np.asarray(expression)
    theta = checked(model, beta[None], np.asarray(pose)[None]).pose
    rotations, features = rotations_and_features(model, theta)
    first, q = feature_joints(model)
    shaped, joints = rest(model, beta, psi if len(psi) else None)
    used = (len(joints) - first) * q
    correct = shape_directions(model)[..., : len(beta)] @ beta - (
        model.shapedirs[..., : len(beta)] @ beta
    )  # STAR's corrective by the second beta
    posed = shaped + correct + model.posedirs[..., :used] @ features[0, first:].ravel()
    G = chain(rotations, joints[None], model.parents)[0]
    blend = np.einsum("vk,kij->vij", model.weights, G[:, :3, :3])
    columns = [*_by_coefficients(model, len(beta), len(psi), G, blend, joints)]
    turned = tangents(model, theta[0], rotations[0], q)
    by_pose = np.zeros((len(posed), 3, model.n_pose if theta.ndim < 4 else 3 * len(joints)))
    for j, c in np.argwhere(turned.column >= 0):
        moved = _moved_maps(model, G, joints, rotations[0], j, turned.omega[j, c])
        skinned = np.einsum("vk,kij,vj->vi", model.weights, moved[..., :3], posed)
        change = skinned + model.weights @ moved[..., 3]
        if j >= first:
            at = (j - first) * q
            offset = model.posedirs[..., at : at + q] @ turned.feature[j, c]
            change = change + np.einsum("vij,vj->vi", blend, offset)
        by_pose[..., turned.column[j, c]] = change
    by_move = np.broadcast_to(np.eye(3), (len(posed), 3, 3))
    return np.concatenate([columns[0], by_pose, by_move, columns[1]], axis=2)


def _moved_maps(
    model: BodyModel, G: Array, joints: Array, rotations: Array, turned: int, omega: Array
) -> Array:
    """Differentiate the skinning maps, (K, 3, 4), when one joint turns by omega."""
    dG = np.zeros_like(G)
    for k, p in enumerate(model.parents):
        step = joints[k] - (joints[p] if p >= 0 else 0)
        up, dup = (G[p], dG[p]) if p >= 0 else (np.eye(4), np.zeros((4, 4)))
        own = cross_matrix(omega) @ rotations[k] if k == turned else np.zeros((3, 3))
        dG[k, :3, :3] = dup[:3, :3] @ rotations[k] + up[:3, :3] @ own
        dG[k, :3, 3] = dup[:3, 3] + dup[:3, :3] @ step
    return np.asarray(skinning_transforms(dG[None], joints[None])[0])


def _by_coefficients(
    model: BodyModel, n_shape: int, n_expression: int, G: Array, blend: Array, joints: Array
) -> list[Array]:
    """Return the columns (V, 3, n) of shape and of expression."""
    basis = fold_joints(model)
    at = 1 + model.n_shape
    none = np.zeros((len(model.v_template), 3, 0))
    faces = model.exprdirs if model.exprdirs is not None else none
    kinds = (
        (shape_directions(model)[..., :n_shape], basis[1 : 1 + n_shape]),
        (faces[..., :n_expression], basis[at : at + n_expression]),
    )
    results = []
    for directions, by_joint in kinds:
        moved = np.zeros((len(by_joint), *joints.shape))
        for k, p in enumerate(model.parents):
            step = by_joint[:, k] - (by_joint[:, p] if p >= 0 else 0)
            moved[:, k] = step if p < 0 else moved[:, p] + step @ G[p, :3, :3].T
        offset = moved - np.einsum("kij,nkj->nki", G[:, :3, :3], by_joint)
        through = np.einsum("vij,vjn->vin", blend, directions)
        results.append(through + np.einsum("vk,nki->vin", model.weights, offset))
    return results
