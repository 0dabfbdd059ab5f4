"""Nail and palm masks for hands that bring none: the nearest surface of the shipped hand.

The shipped hand's rest pose is bent, bone by bone, onto the other hand's joints; each vertex of
the other then reads the masks at the closest point of the bent surface.
"""

from __future__ import annotations

from functools import lru_cache

import igl
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import unit
from synthgen.models import ManoModel, list_models, load_hand
from synthgen.models.joints import TIP_ORDER

Array = NDArray[np.float64]

SOURCE = "cc0-hand"
_TIP_JOINT = dict(zip(TIP_ORDER, (15, 3, 6, 12, 9), strict=True))


@lru_cache(maxsize=8)
def masks_of(model: ManoModel) -> tuple[Array, Array]:
    """Return palm and nail masks (S,) of hand and arm: the model's own, or the shipped hand's."""
    surface = model.surface
    if model.name == SOURCE or SOURCE not in list_models():
        return surface.mask_palm, surface.mask_nail
    source = load_hand(SOURCE, hand=model.hand)
    n_source, n = len(source.v_template), len(model.v_template)
    bent = _bend(source, model)
    _, face, nearest = igl.point_mesh_squared_distance(
        model.v_template, bent, np.ascontiguousarray(source.faces)
    )
    corners = source.faces[face]
    weights = igl.barycentric_coordinates(
        nearest, *(np.ascontiguousarray(bent[c]) for c in corners.T)
    )
    masks = np.stack([source.surface.mask_palm, source.surface.mask_nail], axis=1)[:n_source]
    read = np.einsum("nk,nkm->nm", weights, masks[corners])
    palm, nail = surface.mask_palm.copy(), surface.mask_nail.copy()
    palm[:n], nail[:n] = np.clip(read, 0, 1).T
    return palm, nail


def _bend(source: ManoModel, target: ManoModel) -> Array:
    """Move the source's rest vertices with its skinning onto the target's joints."""
    joints = source.J_regressor @ source.v_template
    goal = target.J_regressor @ target.v_template
    ends = _ends(source, joints), _ends(target, goal)
    moved = np.zeros_like(source.v_template)
    for k in range(len(joints)):
        bone, wanted = ends[0][k] - joints[k], ends[1][k] - goal[k]
        scale = np.linalg.norm(wanted) / max(float(np.linalg.norm(bone)), 1e-6)
        turned = scale * (source.v_template - joints[k]) @ _turn(bone, wanted).T + goal[k]
        moved += source.weights[:, k : k + 1] * turned
    return moved


def _ends(model: ManoModel, joints: Array) -> Array:
    """Far end (16, 3) of each joint's bone: its child, a fingertip, or the middle knuckle."""
    ends = joints.copy()
    ends[0] = joints[[1, 4, 7, 10]].mean(axis=0)
    for k in range(len(joints) - 1, 0, -1):
        if model.parents[k] > 0:
            ends[model.parents[k]] = joints[k]
    for name, vertex in zip(TIP_ORDER, model.fingertip_ids, strict=True):
        ends[_TIP_JOINT[name]] = model.v_template[vertex]
    return ends


def _turn(a: Array, b: Array) -> Array:
    """Smallest rotation (3, 3) that takes the direction of a to that of b."""
    a, b = unit(a), unit(b)
    axis, cosine = np.cross(a, b), float(a @ b)
    cross = np.cross(np.eye(3), axis)
    return np.asarray(np.eye(3) + cross + cross @ cross / max(1 + cosine, 1e-6))
