"""Separating a part from a body: head, hand or foot (SUPR, Eq. 4-5).

A joint belongs to a part if it skins or corrects one of the part's vertices, or lies between such
a joint and the root: without the second rule the chain would be cut. Rows and columns are taken
as they are, so a part in the pose of a body has exactly the body's vertices.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, nearest
from synthgen.models.constrained import ConstrainedTree
from synthgen.models.joints import SMPLH52_NAMES
from synthgen.models.model import BodyModel
from synthgen.models.packed import fold_joints
from synthgen.models.pose_features import feature_joints

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
PartName = Literal["head", "left_hand", "right_hand", "left_foot", "right_foot"]
PARTS = ("head", "left_hand", "right_hand", "left_foot", "right_foot")


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a body, and what of the body it is.

    Attributes
    ----------
    model : BodyModel
        Evaluated like every model; its joints keep their names.
    vertex_ids : (V',) int64
        The body's vertices.
    joint_ids : (K',) int64
        The body's joints: ``pose[:, joint_ids]`` is the part's pose.
    pose_columns : (P',) int64 or None
        Of a constrained body: ``pose[:, pose_columns]`` is the part's pose.
    """

    model: BodyModel
    vertex_ids: Ids
    joint_ids: Ids
    pose_columns: Ids | None = None


def separate(body: BodyModel, part: PartName | NDArray[Any]) -> Part:
    """Separate a part from a body.

    Parameters
    ----------
    body : BodyModel
        Of any family.
    part : str or (n,) int
        "head", "left_hand", "right_hand", "left_foot" or "right_foot" (the vertices that the
        file names as such, else those that the part's own joints move most), or the vertices.

    Raises
    ------
    ModelError
        If the body has no such part, or a vertex that does not exist is asked for.

    Notes
    -----
    Expressions that move nothing of the part are left out.
    """
    vertices = part_vertices(body, part) if isinstance(part, str) else _given(body, part)
    joints = influences(body, vertices)
    tree, columns = _part_tree(body.axis_meta, joints)
    exprdirs = None if body.exprdirs is None else body.exprdirs[vertices]
    basis = fold_joints(body)[:, joints]
    if exprdirs is not None and not exprdirs.any() and not basis[1 + body.n_shape :].any():
        exprdirs, basis = None, basis[: 1 + body.n_shape]
    first, _ = feature_joints(body)
    place = np.full(len(body.v_template), -1)
    place[vertices] = np.arange(len(vertices))
    faces = place[body.faces]
    name = part if isinstance(part, str) else "part"
    parents = np.searchsorted(joints, body.parents[joints])
    parents[0] = -1
    names = tuple(body.joint_names[j] for j in joints)
    model = replace(
        body,
        name=f"{body.name}/{name}",
        digest=_digest(body, vertices),
        v_template=body.v_template[vertices],
        shapedirs=body.shapedirs[vertices],
        exprdirs=exprdirs,
        posedirs=body.posedirs[vertices][:, :, feature_columns(body, joints[joints >= first])],
        weights=body.weights[vertices][:, joints],
        J_regressor=_regressor(body, vertices, exprdirs, basis),
        joint_basis=basis,
        parents=parents,
        faces=faces[(faces >= 0).all(axis=1)],
        joint_names=names,
        hands_left=body.hands_left if _has_hand(names, "left") else None,
        hands_right=body.hands_right if _has_hand(names, "right") else None,
        fingertip_ids=_kept_tips(body, place),
        landmark_ids=np.zeros(0, dtype=np.int64),
        vert_sym_idxs=None,
        part_ids={},
        axis_meta=tree,
    )
    return Part(model, vertices, joints, columns)


def part_vertices(body: BodyModel, part: str) -> Ids:
    """Return a part's vertices: those that the file names, else those its own joints move most.

    Raises
    ------
    ModelError
        If the part or its joints are not known.
    """
    if part in body.part_ids:
        return np.unique(body.part_ids[part])
    if part not in PARTS:
        raise ModelError(f"part {part!r}{nearest(part, PARTS)}; parts are {', '.join(PARTS)}")
    names = body.joint_names
    own = [k for k, name in enumerate(names) if _belongs(name, part)]
    found = np.flatnonzero(np.isin(body.weights.argmax(axis=1), own))
    if not len(found):
        raise ModelError(f"model {body.name!r} has no vertices of a {part}; its joints are {names}")
    return found


def influences(body: BodyModel, vertices: NDArray[Any]) -> Ids:
    """Return the joints that move or correct any of the vertices, and all their ancestors.

    Eq. 4 with the correctives that a file holds: activations are multiplied into them.
    """
    skinned = np.flatnonzero((body.weights[vertices] != 0).any(axis=0))
    active = (body.posedirs[vertices] != 0).any(axis=(0, 1))
    first, q = feature_joints(body)
    k = len(body.parents)
    corrected = first + np.flatnonzero(active[: q * (k - first)].reshape(-1, q).any(axis=1))
    wanted = set(skinned.tolist()) | set(corrected.tolist())
    for joint in sorted(wanted, reverse=True):
        while joint >= 0:
            wanted.add(joint)
            joint = int(body.parents[joint])
    return np.array(sorted(wanted), dtype=np.int64)


def feature_columns(body: BodyModel, joints: Ids) -> Ids:
    """Return the columns of ``posedirs`` that belong to joints (and STAR's shape feature)."""
    first, q = feature_joints(body)
    columns = ((joints - first)[:, None] * q + np.arange(q)).ravel()
    n = body.posedirs.shape[2]
    return np.append(columns, n - 1) if body.family == "star" else columns


def _has_hand(names: tuple[str, ...], side: str) -> bool:
    return {name for name in SMPLH52_NAMES[22:] if name.startswith(side)} <= set(names)


def _belongs(name: str, part: str) -> bool:
    if part == "head":
        return name in ("head", "jaw", "left_eye", "right_eye")
    side, _, kind = part.partition("_")
    if not name.startswith(f"{side}_"):
        return False
    rest = name.removeprefix(f"{side}_")
    if kind == "foot":
        return rest in ("ankle", "foot") or "toe" in rest
    return rest in ("wrist", "hand") or name in SMPLH52_NAMES[22:]


def _given(body: BodyModel, part: NDArray[Any]) -> Ids:
    ids, v = np.unique(np.asarray(part)), len(body.v_template)
    if ids.dtype.kind not in "iu" or not len(ids) or ids[0] < 0 or ids[-1] >= v:
        raise ModelError(f"a part is a list of vertices 0 to {v - 1}; got {np.asarray(part)!r:.80}")
    return ids.astype(np.int64)


def _kept_tips(body: BodyModel, place: NDArray[np.int64]) -> Ids:
    """Fingertips of the sides whose five tips are all in the part."""
    tips = place[body.fingertip_ids].reshape(-1, 5)
    return np.asarray(tips[(tips >= 0).all(axis=1)].ravel(), dtype=np.int64)


def _regressor(body: BodyModel, vertices: Ids, exprdirs: Array | None, basis: Array) -> Array:
    """Return a regressor from the part's own vertices that gives the body's joints.

    The joints of a part depend on vertices that were cut away. Both are affine in the
    coefficients, so the smallest regressor that agrees for every shape and expression is found by
    least squares; it lets a part be written in the form of its family.
    """
    moves = [body.v_template[vertices][..., None], body.shapedirs[vertices]]
    moves += [] if exprdirs is None else [exprdirs]
    points = np.concatenate(moves, axis=2)  # (V', 3, n)
    if body.family == "supr":
        flat = points.reshape(-1, points.shape[2])
        linear = np.linalg.lstsq(flat[:, 1:].T, basis[1:].reshape(len(basis) - 1, -1))[0].T
        offset = basis[0].ravel() - linear @ flat[:, 0]
        return np.concatenate([linear, offset[:, None]], axis=1)
    flat = points.reshape(len(points), -1)
    wanted = basis.transpose(1, 2, 0).reshape(basis.shape[1], -1)
    return np.asarray(np.linalg.lstsq(flat.T, wanted.T)[0].T)


def _part_tree(tree: ConstrainedTree | None, joints: Ids) -> tuple[ConstrainedTree | None, Any]:
    """Return the constrained tree of the kept joints and the pose columns that drive them."""
    if tree is None:
        return None, None
    slots = tree.order[joints]
    s, h = len(tree.spherical), len(tree.hinge)
    ball = np.sort(slots[slots < s])
    hinge = np.sort(slots[(slots >= s) & (slots < s + h)]) - s
    double = np.sort(slots[slots >= s + h]) - s - h
    groups = (tree.spherical[ball], tree.hinge[hinge], tree.double_first[double],
              tree.double_second[double])  # fmt: skip
    columns = np.sort(np.concatenate([g.ravel() for g in groups]))
    renamed = [np.searchsorted(columns, g) for g in groups]
    kept = np.concatenate([ball, hinge + s, double + s + h])
    part = replace(
        tree,
        n_pose=len(columns),
        spherical=renamed[0],
        hinge=renamed[1],
        double_first=renamed[2],
        double_second=renamed[3],
        hinge_axis=tree.hinge_axis[hinge],
        double_first_axis=tree.double_first_axis[double],
        double_second_axis=tree.double_second_axis[double],
        order=np.searchsorted(kept, slots),
    )
    return part, columns


def _digest(body: BodyModel, vertices: Ids) -> str:
    total = hashlib.sha256(body.digest.encode())
    total.update(vertices.tobytes())
    return total.hexdigest()
