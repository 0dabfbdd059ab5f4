"""A model's bases by vertex, float64, for derivatives; the model's own arrays where possible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

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
    correctives : (V, 3, n)
        Columns of joints from ``first`` on, ``n_features`` each.
    active_start : (V + 1,) int64, active_joint : (m,) int32
        Joints whose correctives are not all zero on vertex v:
        ``active_joint[active_start[v]:active_start[v + 1]]``.
    joint_ids : (V, k) int32, weights : (V, k)
    joint_basis : (1 + nb + ne, K, 3)
    parents : (K,) int64
    """

    template: Array
    directions: Array
    expressions: Array
    correctives: Array
    active_start: NDArray[np.int64]
    active_joint: NDArray[np.int32]
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
    used = (k - first) * q
    active = np.any(model.posedirs[..., :used].reshape(v, 3, k - first, q) != 0, axis=(1, 3))
    start = np.zeros(v + 1, dtype=np.int64)
    np.cumsum(active.sum(axis=1), out=start[1:])
    ids, weights = largest_weights(model.weights)
    none = np.zeros((v, 3, 0))
    return RowBases(
        template=np.ascontiguousarray(model.v_template),
        directions=np.ascontiguousarray(shape_directions(model)),
        expressions=none if model.exprdirs is None else np.ascontiguousarray(model.exprdirs),
        correctives=np.ascontiguousarray(model.posedirs),
        active_start=start,
        active_joint=(np.nonzero(active)[1] + first).astype(np.int32),
        joint_ids=ids,
        weights=weights,
        joint_basis=fold_joints(model),
        parents=model.parents,
        first=first,
        n_features=q,
    )
