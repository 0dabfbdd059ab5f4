"""Mirroring models and poses (Embodied Hands A.1-A.5).

M = diag(-1, 1, 1): points and displacements are multiplied by M, faces reversed, and a rotation R
becomes M R M, so that an axis-angle vector (x, y, z) becomes (x, -y, -z) and a quaternion
(x, y, z, w) becomes (x, -y, -z, w). On bodies left and right change places as well, so that a
mirrored body has the vertex and joint order of the original.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.models.constrained import ConstrainedTree
from synthgen.models.joints import LANDMARK_NAMES, swapped_side
from synthgen.models.mano import ManoModel
from synthgen.models.model import BodyModel, HandSpace
from synthgen.models.pose_features import feature_joints
from synthgen.models.surface import Arm, HandSurface
from synthgen.models.symmetry import Symmetry, symmetry_of

Array = NDArray[np.float64]
AnyModel = TypeVar("AnyModel", bound=BodyModel)
_POINT = np.array([-1.0, 1.0, 1.0])
_TURN = np.array([1.0, -1.0, -1.0])
_MATRIX = _POINT[:, None] * _POINT
_QUATERNION = np.array([1.0, -1.0, -1.0, 1.0])


def mirror_pose(pose: NDArray[np.floating], model: BodyModel | None = None) -> Array:
    """Mirror a pose.

    Parameters
    ----------
    pose : (..., 3), (..., K, 3) or (..., P) float
        Axis-angle vectors; with a constrained model its (..., P) angles.
    model : BodyModel or None
        A body, whose left and right joints change places; None: vectors are only turned, which
        is all that a hand needs.

    Returns
    -------
    Array of the same shape
        What :func:`mirror_model` takes to be in the mirrored pose.

    Raises
    ------
    ShapeError
        If the pose does not fit the model.
    ModelError
        If the model's joints have no counterparts.
    """
    values = np.asarray(pose, dtype=np.float64)
    if model is None and values.shape[-1:] != (3,):
        raise ShapeError(f"pose has shape {values.shape}; expected (..., 3) axis-angle vectors")
    if model is None:
        result: Array = values * _TURN
        return result
    tree = model.axis_meta
    if tree is not None and values.shape[-1:] == (tree.n_pose,):
        mirrored = values.copy()
        mirrored[..., tree.spherical] *= _TURN
        return mirrored
    if values.shape[-2:] != (len(model.parents), 3):
        raise ShapeError(f"pose has shape {values.shape}; expected (..., {len(model.parents)}, 3)")
    return np.asarray((values * _TURN)[..., symmetry_of(model).joints, :])


def mirror_model(model: AnyModel, vertices: NDArray[Any] | None = None) -> AnyModel:
    """Return the mirror image of a model; mirroring twice gives the same arrays again.

    A hand becomes the other hand. A body becomes the body that is its mirror image, with vertices
    and joints in the same order: evaluated in :func:`mirror_pose` of a pose, its vertex ``i`` is
    the mirror image of vertex ``symmetry_of(model).vertices[i]``.

    Parameters
    ----------
    model : BodyModel
    vertices : (V,) int or None
        The mirror image of each vertex of a body, where it is known
        (:func:`synthgen.models.symmetry.symmetry_of`).

    Raises
    ------
    ModelError
        If a body's joints or vertices do not pair up.
    """
    pairs = symmetry_of(model, vertices)
    v, j = pairs.vertices, pairs.joints
    mirrored = replace(
        model,
        v_template=model.v_template[v] * _POINT,
        shapedirs=model.shapedirs[v] * _POINT[:, None],
        exprdirs=None if model.exprdirs is None else model.exprdirs[v] * _POINT[:, None],
        posedirs=_mirror_posedirs(model, pairs),
        weights=model.weights[v][:, j],
        J_regressor=_mirror_regressor(model, pairs),
        joint_basis=None if model.joint_basis is None else model.joint_basis[:, j] * _POINT,
        faces=v[model.faces][:, ::-1].copy(),
        hands_left=_mirror_space(model.hands_right),
        hands_right=_mirror_space(model.hands_left),
        fingertip_ids=_mirror_tips(model, pairs),
        landmark_ids=_mirror_landmarks(model, pairs),
        part_ids={swapped_side(k): np.sort(v[ids]) for k, ids in model.part_ids.items()},
        axis_meta=_mirror_tree(model.axis_meta, pairs),
    )
    return _mirror_hand(mirrored) if isinstance(mirrored, ManoModel) else mirrored


def _mirror_hand(model: ManoModel) -> Any:
    """Finish a hand whose bases are mirrored already."""
    turn = np.tile(_TURN, len(model.parents) - 1)
    mean, rows = model.hands_mean, model.hands_components
    return replace(
        model,
        hand="left" if model.hand == "right" else "right",
        hands_mean=None if mean is None else mean * turn,
        hands_components=None if rows is None else rows * turn,
        joint_axes=None if model.joint_axes is None else model.joint_axes * _TURN,
        surface=_mirror_surface(model.surface),
    )


def _mirror_posedirs(model: BodyModel, pairs: Symmetry) -> Array:
    """Sign of the displacement times the signs of the feature; joints change places."""
    first, q = feature_joints(model)
    sign = _MATRIX.ravel() if q == 9 else _QUATERNION
    used = pairs.joints[first:] - first  # the root is its own counterpart
    n = len(used) * q
    blocks = model.posedirs[pairs.vertices, :, :n].reshape(len(pairs.vertices), 3, -1, q)
    blocks = blocks[:, :, used] * sign * _POINT[:, None, None]
    rest = model.posedirs[pairs.vertices, :, n:] * _POINT[:, None]  # STAR's shape feature
    return np.concatenate([blocks.reshape(len(blocks), 3, n), rest], axis=2)


def _mirror_regressor(model: BodyModel, pairs: Symmetry) -> Array:
    v, j = pairs.vertices, pairs.joints
    if model.family != "supr" or model.J_regressor.shape[0] == len(j):
        return model.J_regressor[j][:, v]
    rows, columns = _coordinates(j), _coordinates(v)
    linear = model.J_regressor[rows][:, columns]
    linear *= np.tile(_POINT, len(j))[:, None] * np.tile(_POINT, len(v))
    offset = model.J_regressor[rows, -1] * np.tile(_POINT, len(j))
    return np.concatenate([linear, offset[:, None]], axis=1)


def _coordinates(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places of x, y, z of each id in a flat array of points."""
    return (3 * ids[:, None] + np.arange(3)).ravel()


def _mirror_space(space: HandSpace | None) -> HandSpace | None:
    if space is None:
        return None
    turn = np.tile(_TURN, len(space.mean) // 3)
    return replace(space, mean=space.mean * turn, components=space.components * turn)


def _mirror_tips(model: BodyModel, pairs: Symmetry) -> NDArray[np.int64]:
    ids = pairs.vertices[model.fingertip_ids]
    return np.concatenate([ids[5:], ids[:5]]) if len(ids) == 10 else ids


def _mirror_landmarks(model: BodyModel, pairs: Symmetry) -> NDArray[np.int64]:
    if not len(model.landmark_ids):
        return model.landmark_ids
    other = [LANDMARK_NAMES.index(swapped_side(name)) for name in LANDMARK_NAMES]
    return pairs.vertices[model.landmark_ids[other]]


def _mirror_tree(tree: ConstrainedTree | None, pairs: Symmetry) -> ConstrainedTree | None:
    """Turn the axes; a joint is driven by the numbers that drove its counterpart."""
    if tree is None:
        return None
    return replace(
        tree,
        hinge_axis=tree.hinge_axis * _TURN,
        double_first_axis=tree.double_first_axis * _TURN,
        double_second_axis=tree.double_second_axis * _TURN,
        order=tree.order[pairs.joints],
    )


def _mirror_surface(surface: HandSurface) -> HandSurface:
    arm = surface.arm
    mirrored = Arm(
        template=arm.template * _POINT,
        shapedirs=arm.shapedirs * _POINT[:, None],
        weights=arm.weights,
        elbow=arm.elbow * _POINT,
        elbow_shapedirs=arm.elbow_shapedirs * _POINT[:, None],
        faces=arm.faces[:, ::-1].copy(),
        end_ids=arm.end_ids,
    )
    return replace(
        surface,
        arm=mirrored,
        faces=surface.faces[:, ::-1].copy(),
        uv_faces=surface.uv_faces[:, ::-1].copy(),
    )
