"""Constrained SUPR trees: spherical, hinge and double-hinge joints driven by (B, P) angles.

A file's ``axis_meta`` lists which of the P numbers drive which joint. Two readings of it:

``official``
    Bit-compatible with the published code. A hinge turns its joint by R(axis, -angle) while its
    correctives see +angle; a double hinge turns by R(axis1, -a1) R(axis2, -a2) while its
    correctives see the product of the two quaternions *after* the identity was taken off each,
    which is zero whenever one angle is zero.
``consistent``
    The same rotations, and correctives driven by them as in an unconstrained tree: what the
    stored axes with their sign flipped give, R(-axis, angle), with feature q1 q2 - identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Constrained = Literal["official", "consistent"]


@dataclass(frozen=True, eq=False, kw_only=True)
class ConstrainedTree:
    """Which numbers of a constrained pose drive which joint; indices as in ``axis_meta``.

    Attributes
    ----------
    n_pose : int
        P, numbers in a pose.
    spherical : (S, 3) int64
        Pose columns of each spherical joint.
    hinge : (H,) int64
        Pose column of each hinge.
    double_first, double_second : (D,) int64
        Pose columns of each double hinge.
    hinge_axis : (H, 3), double_first_axis, double_second_axis : (D, 3)
        Axes as stored, rest frame.
    order : (K,) int64
        ``reverse_indx``: joint j is row ``order[j]`` of [spherical, hinges, double hinges].
    """

    n_pose: int
    spherical: Ids
    hinge: Ids
    double_first: Ids
    double_second: Ids
    hinge_axis: Array
    double_first_axis: Array
    double_second_axis: Array
    order: Ids

    @staticmethod
    def from_meta(meta: dict[str, Any], n_joints: int) -> ConstrainedTree:
        """Read a file's ``axis_meta``.

        Raises
        ------
        ModelError
            If a key is missing, or an index does not fit the pose, the axes or the joints.
        """
        missing = [key for key in META_KEYS if key not in meta]
        if missing:
            raise ModelError(f"axis_meta has no {', '.join(missing)}; needed are {META_KEYS}")
        ids = {key: _ids(meta[key], key) for key in META_KEYS if key != "axis"}
        axes = _axes(meta["axis"])
        axes = axes[_within(ids["axis_indx"], len(axes), "axis_indx")]
        tree = ConstrainedTree(
            n_pose=_single(ids["num_pose"], "num_pose"),
            spherical=_threes(ids["indx_spherical"], "indx_spherical"),
            hinge=ids["indx_hinge"].ravel(),
            double_first=ids["indx_double_hinge1"].ravel(),
            double_second=ids["indx_double_hinge2"].ravel(),
            hinge_axis=_picked(axes, ids, "indx_hinge_axis"),
            double_first_axis=_picked(axes, ids, "indx_double_hinge1_axis"),
            double_second_axis=_picked(axes, ids, "indx_double_hinge2_axis"),
            order=ids["reverse_indx"].ravel(),
        )
        tree._check(n_joints)
        return tree

    def to_meta(self) -> dict[str, Any]:
        """Return ``axis_meta`` as a file holds it; :meth:`from_meta` reads it back exactly."""
        h, d = len(self.hinge), len(self.double_first)
        axes = np.concatenate([self.hinge_axis, self.double_first_axis, self.double_second_axis])
        return {
            "num_pose": self.n_pose,
            "indx_spherical": self.spherical.tolist(),
            "indx_hinge": self.hinge[:, None].tolist(),
            "indx_double_hinge1": self.double_first.tolist(),
            "indx_double_hinge2": self.double_second.tolist(),
            "indx_hinge_axis": list(range(h)),
            "indx_double_hinge1_axis": list(range(h, h + d)),
            "indx_double_hinge2_axis": list(range(h + d, h + 2 * d)),
            "reverse_indx": self.order.tolist(),
            "axis_indx": list(range(len(axes))),
            "axis": axes[None],
        }

    def _check(self, n_joints: int) -> None:
        counts = (len(self.spherical), len(self.hinge), len(self.double_first))
        if len(self.double_second) != counts[2]:
            raise ModelError(
                f"axis_meta: {counts[2]} first and {len(self.double_second)} second double hinges"
            )
        if len(self.hinge_axis) != counts[1] or {
            len(self.double_first_axis),
            len(self.double_second_axis),
        } != {counts[2]}:
            raise ModelError("axis_meta: the numbers of hinges and of their axes differ")
        if sum(counts) != n_joints or sorted(self.order.tolist()) != list(range(n_joints)):
            raise ModelError(
                f"axis_meta describes {counts[0]} spherical, {counts[1]} hinge and {counts[2]} "
                f"double-hinge joints; reverse_indx must order all {n_joints} joints once"
            )
        groups = (self.spherical, self.hinge, self.double_first, self.double_second)
        used = np.concatenate([g.ravel() for g in groups])
        # lengths first: a file may claim more numbers than fit into memory
        if len(used) != self.n_pose or sorted(used.tolist()) != list(range(self.n_pose)):
            raise ModelError(
                f"axis_meta: num_pose is {self.n_pose}, but the index lists name {len(used)} "
                f"columns, {len(np.unique(used))} of them different"
            )


META_KEYS = (
    "num_pose", "indx_spherical", "indx_hinge", "indx_double_hinge1", "indx_double_hinge2",
    "indx_hinge_axis", "indx_double_hinge1_axis", "indx_double_hinge2_axis", "reverse_indx",
    "axis_indx", "axis",
)  # fmt: skip


def _ids(value: Any, key: str) -> Ids:
    array = np.asarray(value)
    if array.size == 0:
        return np.zeros(0, dtype=np.int64)
    if array.dtype.kind not in "iuf" or np.any(array != np.round(array)):
        raise ModelError(f"axis_meta: {key} holds {array.dtype}; expected whole numbers")
    return array.astype(np.int64)


def _axes(value: Any) -> Array:
    array = np.asarray(value)
    if array.dtype.kind not in "iuf" or array.ndim < 2 or array.shape[-1] != 3:
        raise ModelError(f"axis_meta: axis is {array.dtype}{array.shape}; expected (1, A, 3)")
    if not np.isfinite(array).all():
        raise ModelError("axis_meta: axis must be finite; it holds NaN or infinity")
    return array.astype(np.float64).reshape(-1, 3)


def _single(ids: Ids, key: str) -> int:
    if ids.size != 1:
        raise ModelError(f"axis_meta: {key} holds {ids.size} numbers; expected one")
    return int(ids.ravel()[0])


def _threes(ids: Ids, key: str) -> Ids:
    if ids.size and ids.shape[-1] != 3:
        raise ModelError(f"axis_meta: {key} is {ids.shape}; expected threes, (S, 3)")
    return ids.reshape(-1, 3)


def _within(ids: Ids, n: int, key: str) -> Ids:
    flat = ids.ravel()
    if flat.size and (flat.min() < 0 or flat.max() >= n):
        raise ModelError(f"axis_meta: {key} refers to {int(flat.max())} of {n}")
    return flat


def _picked(axes: Array, ids: dict[str, Ids], key: str) -> Array:
    picked: Array = axes[_within(ids[key], len(axes), key)]
    return picked
