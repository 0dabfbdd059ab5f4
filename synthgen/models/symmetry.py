"""Which vertex and which joint of a body is whose mirror image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models.joints import swapped_side

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Ids = NDArray[np.int64]
# A body of 1.7 m: published templates are symmetric to a few millimetres, their vertices are
# farther apart than that nearly everywhere.
TOLERANCE_M = 0.01


@dataclass(frozen=True, eq=False)
class Symmetry:
    """Permutations that are their own inverse.

    Attributes
    ----------
    vertices : (V,) int64
    joints : (K,) int64
    """

    vertices: Ids
    joints: Ids


def symmetry_of(model: BodyModel, vertices: NDArray[Any] | None = None) -> Symmetry:
    """Find the left/right permutation of a model.

    Hands and other parts that carry no sides in their joint names become their counterpart as a
    whole: nothing is permuted.

    Parameters
    ----------
    model : BodyModel
    vertices : (V,) int or None
        The mirror image of each vertex; None: the file's ``vert_sym_idxs``, else found by
        geometry.

    Raises
    ------
    ModelError
        If a joint lacks its counterpart, or vertices do not pair up.
    """
    joints = _joints(model)
    v = len(model.v_template)
    if (joints == np.arange(len(joints))).all():
        return Symmetry(np.arange(v), joints)
    given = model.vert_sym_idxs if vertices is None else vertices
    pairs = _nearest(model) if given is None else np.asarray(given, dtype=np.int64)
    if pairs.shape != (v,) or pairs.min() < 0 or pairs.max() >= v:
        raise ModelError(f"{model.name}: {pairs.shape} mirrored vertices; expected {v} of {v}")
    _check_pairs(model, pairs)
    return Symmetry(pairs, joints)


def _joints(model: BodyModel) -> Ids:
    names = model.joint_names
    lacking = [n for n in names if swapped_side(n) not in names]
    if lacking:
        raise ModelError(
            f"{model.name}: joint {lacking[0]!r} has no counterpart {swapped_side(lacking[0])!r}; "
            "a body with one side only cannot be mirrored onto itself"
        )
    joints = np.array([names.index(swapped_side(n)) for n in names], dtype=np.int64)
    parents = model.parents
    mirrored = np.where(parents[joints] < 0, -1, joints[parents[joints]])
    if (mirrored != parents).any():
        j = int(np.flatnonzero(mirrored != parents)[0])
        raise ModelError(
            f"{model.name}: the tree is not symmetric: {names[j]!r} and {names[joints[j]]!r} hang "
            "from joints that are no counterparts"
        )
    return joints


def _nearest(model: BodyModel) -> Ids:
    """Pair every vertex with the one nearest to its mirror image."""
    from scipy.spatial import cKDTree

    v = model.v_template
    return np.asarray(cKDTree(v).query(v * [-1.0, 1.0, 1.0])[1], dtype=np.int64)


def _check_pairs(model: BodyModel, pairs: Ids) -> None:
    v = model.v_template
    alone = np.flatnonzero(pairs[pairs] != np.arange(len(pairs)))
    if len(alone):
        raise ModelError(
            f"{model.name}: {len(alone)} vertices have no mirror image of their own (the first is "
            f"{alone[0]}); pass vertices= with the counterpart of each vertex"
        )
    off = np.linalg.norm(v[pairs] * [-1.0, 1.0, 1.0] - v, axis=1)
    if off.max() > TOLERANCE_M:
        worst = int(off.argmax())
        raise ModelError(
            f"{model.name}: vertex {worst} and its counterpart {pairs[worst]} are "
            f"{1000 * off[worst]:.1f} mm from mirror images; at most {1000 * TOLERANCE_M:.0f} mm "
            "are taken for symmetry about the plane x = 0"
        )
