"""A model's bases as the kernels want them: one row per coefficient, few weights, no zeros.

* Shape, expression and densely active correctives are the rows of one matrix, so that the posed
  template of a batch is one product.
* Correctives that are zero on most vertices (a hand's on a body, nearly all of SUPR's) are kept
  by vertex, in runs of joints that follow one another.
* Joints depend on shape and expression only: their regressor is folded with the bases.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models.pose_features import feature_joints

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]
# A joint whose correctives touch a smaller share of the vertices is kept sparse.
SPARSE_SHARE = 0.4
# Weights that sum to 1 within this are taken to do so exactly.
_UNIT_SUM = 1e-9


@dataclass(frozen=True, eq=False)
class Runs:
    """Sparse correctives by vertex.

    Attributes
    ----------
    vertices : (c,) int64
        Those that have any.
    start : (V + 1,) int64
        Runs of vertex v are ``start[v]:start[v + 1]``.
    feature : (n,) int64
        Where a run begins in the (K q) joint features.
    offset : (n + 1,) int64
        Where its 3 equal rows x, y, z lie in ``values``.
    values : (m,)
    """

    vertices: NDArray[np.int64]
    start: NDArray[np.int64]
    feature: NDArray[np.int64]
    offset: NDArray[np.int64]
    values: NDArray[Any]


@dataclass(frozen=True, eq=False)
class Packed:
    """Bases for the kernels, of one floating type.

    Attributes
    ----------
    basis : (R, 3 V)
        Rows: dense pose features, template, shape, expression; columns: x y z of each vertex.
    dense : (nd,) int64
        Columns of the (K q) joint features that the first rows belong to.
    runs : Runs
        Sparse correctives.
    joint_ids : (V, k) int32, weights : (V, k)
        The largest weights of each vertex, in descending order; k is the largest number of
        nonzero ones, up to the next multiple of four.
    excess : (V,)
        Sum of a vertex's weights minus 1, zero in a well-made file.
    joint_basis : (1 + nb + ne, 3 K) float64
        Rest joints of [1, shape, expression].
    parents : (K,) int64
    n_features : int
        q, features a joint: 9 or 4.
    """

    basis: NDArray[Any]
    dense: NDArray[np.int64]
    runs: Runs
    joint_ids: NDArray[np.int32]
    weights: NDArray[Any]
    excess: NDArray[Any]
    joint_basis: Array
    parents: NDArray[np.int64]
    n_features: int

    @property
    def nbytes(self) -> int:
        """Bytes that one evaluation of one sample with all coefficients reads."""
        skinning = self.joint_ids.nbytes + self.weights.nbytes + self.excess.nbytes
        runs = self.runs.values.nbytes + self.runs.feature.nbytes + self.runs.offset.nbytes
        return self.basis.nbytes + skinning + runs + self.joint_basis.nbytes


def pack(model: BodyModel, dtype: type[np.float32] | type[np.float64]) -> Packed:
    """Lay out a model's bases in a floating type."""
    first, q = feature_joints(model)
    v, k = model.weights.shape
    driven = k - first
    correctives = model.posedirs[..., : driven * q].reshape(v, 3, driven, q)
    active = np.any(correctives != 0, axis=(1, 3))
    dense = active.mean(axis=0) >= SPARSE_SHARE
    columns = (np.flatnonzero(dense)[:, None] * q + np.arange(q)).ravel()
    rows = [model.posedirs[..., columns], model.v_template[..., None], shape_directions(model)]
    if model.exprdirs is not None:
        rows.append(model.exprdirs)
    ids, weights = largest_weights(model.weights)
    fill = ((0, 0), (0, -ids.shape[1] % 4))
    excess = model.weights.sum(axis=1) - 1
    return Packed(
        basis=np.concatenate([_flat(r, dtype) for r in rows]),
        dense=columns + first * q,
        runs=_runs(correctives, active & ~dense, first, dtype),
        joint_ids=np.pad(ids, fill),
        weights=np.pad(weights, fill).astype(dtype),
        excess=np.where(np.abs(excess) < _UNIT_SUM, 0, excess).astype(dtype),
        joint_basis=fold_joints(model).reshape(-1, 3 * k),
        parents=np.array(model.parents, np.int64),
        n_features=q,
    )


def fold_joints(model: BodyModel) -> Array:
    """Return rest joints as an affine function of [1, shape, expression]: (1 + nb + ne, K, 3)."""
    if model.joint_basis is not None:
        return np.array(model.joint_basis, np.float64, order="C")
    parts = [model.v_template[..., None], model.shapedirs]
    if model.exprdirs is not None:
        parts.append(model.exprdirs)
    bases = np.concatenate(parts, axis=2)
    if model.family == "supr":
        affine = model.J_regressor
        folded = (affine[:, :-1] @ bases.reshape(-1, bases.shape[2])).T
        folded[0] += affine[:, -1]
        return np.ascontiguousarray(folded.reshape(len(folded), -1, 3))
    flat = model.J_regressor @ bases.reshape(len(bases), -1)
    return np.ascontiguousarray(flat.reshape(len(flat), 3, -1).transpose(2, 0, 1))


def largest_weights(weights: Array) -> tuple[NDArray[np.int32], Array]:
    """Return joints (V, k) and weights (V, k), k the largest number of nonzero weights a row."""
    k = max(int((weights != 0).sum(axis=1).max()), 1)
    order = np.argsort(-np.abs(weights), axis=1, kind="stable")[:, :k]
    return order.astype(np.int32), np.take_along_axis(weights, order, axis=1)


def shape_directions(model: BodyModel) -> Array:
    """Return ``shapedirs`` (V, 3, nb); STAR's corrective by beta 1 is linear, so it is added."""
    if model.family != "star" or model.n_shape < 2:
        return model.shapedirs
    directions = model.shapedirs.copy()
    directions[..., 1] += model.posedirs[..., -1]
    return directions


def _flat(basis: Array, dtype: Any) -> NDArray[Any]:
    """(V, 3, n) -> (n, 3 V)."""
    return np.ascontiguousarray(basis.reshape(3 * len(basis), basis.shape[2]).T, dtype)


def _runs(correctives: Array, active: NDArray[np.bool_], first: int, dtype: Any) -> Runs:
    """Correctives (V, 3, J, q) where (V, J) are active, by vertex and run of joints."""
    v, joints = active.shape
    q = correctives.shape[3]
    edges = np.diff(np.pad(active, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    vertex, begin = np.nonzero(edges == 1)
    length = (np.nonzero(edges == -1)[1] - begin) * q
    start = np.zeros(v + 1, dtype=np.int64)
    np.cumsum(np.bincount(vertex, minlength=v), out=start[1:])
    offset = np.zeros(len(vertex) + 1, dtype=np.int64)
    np.cumsum(3 * length, out=offset[1:])
    rows = correctives.reshape(v, 3, joints * q)
    pieces = zip(vertex, begin * q, length, strict=True)
    values = [rows[n, :, b : b + size].ravel() for n, b, size in pieces]
    flat = np.concatenate(values) if values else np.zeros(0)
    return Runs(np.unique(vertex), start, (begin + first) * q, offset, flat.astype(dtype))
