"""A model's bases by vertex, for derivatives; the model's own arrays where possible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models.jacobian_kernels import LANES
from synthgen.models.packed import fold_joints, largest_weights, shape_directions
from synthgen.models.pose_features import feature_joints

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RowBases:
    """Bases by vertex.

    Attributes
    ----------
    template : (V, 3), directions : (V, 3, nb), expressions : (V, 3, ne)
    correctives : (V, 3, n, q LANES) float32
        Of the joints from ``first`` on, in n blocks of LANES joints, feature by feature.
    reach : (V, 2) int64
        First block with correctives on the vertex that are not zero, and the one after the last.
    joint_ids : (V, k) int32, weights : (V, k)
    joint_basis : (1 + nb + ne, K, 3)
    parents : (K,) int64
    """

    template: Array
    directions: Array
    expressions: Array
    correctives: NDArray[np.float32]
    reach: NDArray[np.int64]
    joint_ids: NDArray[np.int32]
    weights: Array
    joint_basis: Array
    parents: NDArray[np.int64]
    first: int
    n_features: int


def row_bases(model: BodyModel) -> RowBases:
    """Gather a model's bases by vertex."""
    first, q = feature_joints(model)
    v, k = model.weights.shape
    driven = k - first
    by_joint = model.posedirs[..., : driven * q].reshape(v, 3, driven, q)
    blocks = in_lanes(by_joint.transpose(0, 1, 3, 2).astype(np.float32))
    active = np.any(blocks != 0, axis=(1, 3))
    end = np.where(active.any(axis=1), active.shape[1] - active[:, ::-1].argmax(axis=1), 0)
    reach = np.stack([np.minimum(active.argmax(axis=1), end), end], axis=1)
    ids, weights = largest_weights(model.weights)
    none = np.zeros((v, 3, 0))
    return RowBases(
        template=np.ascontiguousarray(model.v_template),
        directions=np.ascontiguousarray(shape_directions(model)),
        expressions=none if model.exprdirs is None else np.ascontiguousarray(model.exprdirs),
        correctives=blocks,
        reach=reach,
        joint_ids=ids,
        weights=weights,
        joint_basis=fold_joints(model),
        parents=model.parents,
        first=first,
        n_features=q,
    )


def in_lanes(values: NDArray[Any]) -> NDArray[Any]:
    """(..., q, J) -> (..., n, q LANES): joints in blocks of LANES, filled up with zeros."""
    *lead, q, joints = values.shape
    n = -(-joints // LANES)
    filled = np.pad(values, [(0, 0)] * (len(lead) + 1) + [(0, n * LANES - joints)])
    blocks = filled.reshape(*lead, q, n, LANES).swapaxes(-2, -3)
    return np.ascontiguousarray(blocks).reshape(*lead, n, q * LANES)
