"""Simulated contact of a foot with the ground: what the foot network learns from.

The foot's 266 points form an elastic sheet. Points under the ground are lifted onto it, the sheet
carries their move to the neighbours, and the flesh that is pushed away bulges around the contact.
A model of its own, not measured feet: the papers' scanner sees through a glass plate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthgen.cc0.correctives import geodesics
from synthgen.cc0.foundation import Foundation
from synthgen.cc0.skeleton import TOES
from synthgen.geometry.normals import vertex_normals
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models.chain import chain, skinning_transforms
from synthgen.models.foot import CONTACT_M, N_POINTS
from synthgen.models.pose_features import quaternion_feature

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

JOINTS = ("knee", "ankle", "foot", *(f"{toe}{k}" for toe in TOES for k in (1, 2)))
_PARENTS = np.array([-1, 0, 1, *(2 if k % 2 == 0 else 2 + k for k in range(10))])
# The sole's points lie twice as dense as the others.
_SOLE_DENSITY = 2.0
# Reach of the sheet's springs and of a point's offset on the skin around it, metres.
_SPRING_M, _SPREAD_M = 0.012, 0.0045
# Pull of a point back to its place, against springs of unit total; of the bulge likewise.
_ANCHOR, _BULGE_ANCHOR, _BULGE_SHARE = 0.15, 0.6, 0.4
_DEPTH_M = (0.001, 0.008)


@dataclass(frozen=True, eq=False)
class Foot:
    """The right foot of the mean body.

    Attributes
    ----------
    ids : (n,) int64
        Its vertices in the body.
    chosen : (266,) int64
        Rows of ``ids`` that are the network's points.
    points : (n, 3), joints : (13, 3), weights : (n, 13)
    shapes : (266, 3, nb) and joint_shapes : (13, 3, nb)
    basis : (2, nb)
        First two components of the foot's own shape space, of unit variance.
    springs : (266, 266)
        Graph Laplacian of the sheet.
    normals : (266, 3)
    spread : (n, 266)
    """

    ids: Ints
    chosen: Ints
    points: Array
    joints: Array
    weights: Array
    shapes: Array
    joint_shapes: Array
    basis: Array
    springs: Array
    normals: Array
    spread: Array


def right_foot(base: Foundation, ids: Ints) -> Foot:
    """Lay the network's points and the elastic sheet on the right foot (vertices ids)."""
    place = np.full(base.cut.n_body, -1)
    place[ids] = np.arange(len(ids))
    faces = place[base.cut.faces]
    faces = faces[(faces >= 0).all(axis=1)]
    points = base.template[ids]
    rows = [base.skeleton.index(f"right_{name}") for name in JOINTS]
    weights = base.weights[ids][:, rows]
    weights /= weights.sum(axis=1, keepdims=True)
    normals = vertex_normals(points, faces)
    chosen = _even_points(points, normals)
    away = geodesics(points, faces)[:, chosen]
    spread = np.exp(-((away / _SPREAD_M) ** 2))
    spread[spread < np.sort(spread, axis=1)[:, -6:-5]] = 0
    spread /= np.maximum(spread.sum(axis=1, keepdims=True), 1e-12)
    near = np.exp(-((away[chosen] / _SPRING_M) ** 2))
    np.fill_diagonal(near, 0)
    springs = np.diag(near.sum(axis=1)) - near
    shapes = base.shapes[ids]
    joint_shapes = np.einsum("kv,vcn->kcn", base.regressor[rows], base.shapes[: base.cut.n_body])
    local = (shapes - joint_shapes[1]).reshape(-1, shapes.shape[2])
    _, _, axes = np.linalg.svd(local, full_matrices=False)
    length = shapes[points[:, 2].argmax(), 2] - shapes[points[:, 2].argmin(), 2]
    sign = np.sign(axes[:2] @ length)  # a positive coefficient makes the foot longer
    return Foot(
        ids, chosen, points, base.joints[rows], weights, shapes[chosen], joint_shapes,
        axes[:2] * sign[:, None], springs, normals[chosen], spread,
    )  # fmt: skip


def _even_points(points: Array, normals: Array) -> Ints:
    """Farthest-point subset, denser on the sole."""
    sole = (normals[:, 1] < -0.4) & (points[:, 1] < np.quantile(points[:, 1], 0.45))
    density = np.where(sole, _SOLE_DENSITY, 1.0)
    chosen = [int(points[:, 1].argmin())]
    away = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < N_POINTS:
        chosen.append(int((away * density).argmax()))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def simulate(foot: Foot, n: int, *, rng: np.random.Generator) -> tuple[Array, Array]:
    """Simulate n feet; a quarter touches nothing.

    Returns
    -------
    feature : (n, 320)
        Inputs of the network.
    offsets : (n, 266, 3)
        Rest-pose offsets, metres.
    """
    poses = _poses(n, rng)
    betas = rng.standard_normal((n, foot.basis.shape[1]))
    rest = foot.points[foot.chosen] + np.einsum("vcb,nb->nvc", foot.shapes, betas)
    joints = foot.joints + np.einsum("kcb,nb->nkc", foot.joint_shapes, betas)
    maps = skinning_transforms(chain(matrix_from_axis_angle(poses), joints, _PARENTS), joints)
    blended = np.einsum("vk,nkij->nvij", foot.weights[foot.chosen], maps)
    posed = np.einsum("nvij,nvj->nvi", blended[..., :3], rest) + blended[..., 3]
    contact = np.zeros((n, N_POINTS), dtype=bool)
    offsets = np.zeros((n, N_POINTS, 3))
    for i in range(n):
        normals = np.einsum("vij,vj->vi", blended[i, ..., :3], foot.normals)
        up = _ground(posed[i], normals, rng)
        height = posed[i] @ up
        if rng.random() < 0.25:
            continue
        height = height - height.min() - rng.uniform(*_DEPTH_M)
        contact[i] = height <= CONTACT_M
        moved = _pressed(foot.springs, height, normals, up)
        offsets[i] = np.linalg.solve(blended[i, ..., :3], moved[..., None])[..., 0]
    feature = np.concatenate(
        [quaternion_feature(poses).reshape(n, -1), betas @ foot.basis.T, contact], axis=1
    )
    return feature, offsets


def _poses(n: int, rng: np.random.Generator) -> Array:
    """Knee, ankle, ball and toes, axis-angle (n, 13, 3)."""
    degrees = np.zeros((n, len(JOINTS), 3))
    degrees[:, 0, 0] = rng.uniform(0, 60, n)
    degrees[:, 1] = rng.normal(0, [12, 5, 6], (n, 3))
    degrees[:, 2, 0] = rng.normal(-6, 9, n)
    degrees[:, 3:, 0] = rng.normal(-4, 9, (n, 10))
    return np.deg2rad(degrees)


def _ground(points: Array, normals: Array, rng: np.random.Generator) -> Array:
    """Up direction of a ground that the sole meets: flat on it, or heel or toes first."""
    low = normals @ np.array([0.0, -1.0, 0.0])
    sole = points[np.argsort(-low)[:90]]
    up = np.linalg.svd(sole - sole.mean(axis=0))[2][2]
    up = up * np.sign(up @ -normals[np.argsort(-low)[:90]].mean(axis=0))
    pitch = rng.normal(0, 3) if rng.random() < 0.7 else rng.normal(0, 12)
    tilt = Rotation.from_euler("xz", [pitch, rng.normal(0, 3)], degrees=True)
    return np.asarray(tilt.apply(up))


def _pressed(springs: Array, height: Array, normals: Array, up: Array) -> Array:
    """Lift what is under the ground onto it; the sheet follows, and bulges around the contact."""
    lift = np.zeros(len(height))
    held = height < 0
    soft = springs + _ANCHOR * np.eye(len(height))
    for _ in range(4):
        free = ~held
        lift[held] = -height[held]
        lift[free] = np.linalg.solve(
            soft[np.ix_(free, free)], -soft[np.ix_(free, held)] @ lift[held]
        )
        under = free & (height + lift < -1e-6)
        if not under.any():
            break
        held |= under
    squeezed = np.linalg.solve(
        springs + _BULGE_ANCHOR * np.eye(len(height)), _BULGE_SHARE * np.where(held, lift, 0)
    )
    aside = normals - (normals @ up)[:, None] * up
    return np.asarray(lift[:, None] * up + np.where(held, 0, squeezed)[:, None] * aside)
