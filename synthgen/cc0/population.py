"""Whole bodies of many adults in the zero pose: T-pose, palms down, fingers flat, y up, +z front.

Everybody is made symmetric first, so that templates, components, weights and regressors are; the
left arm is the mirrored right one. Joints are what the regressor says (``J = J_regressor V`` is
their definition), so regressor and straightening are iterated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.cc0.adults import sample_bodies
from synthgen.cc0.hand import CHAIN, bone_weights, hand_quads, straighten, triangles
from synthgen.cc0.people import Region
from synthgen.cc0.regressor import regress_joints
from synthgen.cc0.skeleton import SUPR75, TOES
from synthgen.cc0.source import MakeHuman
from synthgen.cc0.unpose import DIGITS, dual_quaternion_skin, flatten, place
from synthgen.errors import ModelError
from synthgen.geometry.rotations import (
    axis_angle_from_matrix,
    matrix_from_axis_angle,
    swing_between,
)
from synthgen.models import ManoModel
from synthgen.models.joints import FINGERS, swapped_side

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_MIRROR = np.array([-1.0, 1.0, 1.0])
# Mean and spread of stature, metres: men, women.
STATURE_M = ((1.75, 0.07), (1.625, 0.065))
# Half-way between the hips, raised.
_PELVIS_RISE_M = 0.04
# Share of the arm's swing to the T-pose that the shoulder blade makes.
_BLADE_SHARE = 0.25
_RIGHT_HAND = tuple(
    SUPR75.index(n) for n in ("right_wrist", *(f"right_{f}{k}" for f in FINGERS for k in (1, 2, 3)))
)


@dataclass(frozen=True, eq=False)
class BodyCut:
    """Topology of the body and of the separate meshes in and around it.

    Attributes
    ----------
    faces, texture : (F, 3) int64
        The body's triangles; vertex and texture-vertex ids.
    n_body : int
        The body's vertices are the first of the source's.
    ids : (S,) int64
        Source ids of body, then extras.
    extras : dict of (n,) int64
        Rows of ``ids`` by name of the separate mesh.
    quads : dict of (n, 4) int64
        Faces of the separate meshes, into their own rows.
    mirror : (S,) int64
        Row of every vertex' counterpart on the other side.
    bones : tuple of str
    bone_weights : (S, M)
    hand_ids : (H,) int64
        The right hand's vertices in the order of the hand model.
    """

    faces: Ints
    texture: Ints
    n_body: int
    ids: Ints
    extras: dict[str, Ints]
    quads: dict[str, Ints]
    mirror: Ints
    bones: tuple[str, ...]
    bone_weights: Array
    hand_ids: Ints


@dataclass(frozen=True, eq=False)
class Bodies:
    """Adults in the zero pose, pelvis at the origin, metres.

    Attributes
    ----------
    vertices : (n, S, 3)
        Body, then extras, in the order of the cut.
    regressor : (75, V)
        Of the SUPR-form joints; every row sums to 1.
    stature : (n,)
    """

    vertices: Array
    regressor: Array
    stature: Array


def cut_body(source: MakeHuman, hand: ManoModel) -> BodyCut:
    """Select body, eyes, lashes, teeth, tongue and tights; match the hand model's vertices."""
    body = source.groups["body"]
    faces, texture = triangles(body, np.ones(len(body.vertices), dtype=bool))
    n_body = int(body.vertices.max()) + 1
    groups = {
        "eyes": ("helper-l-eye", "helper-r-eye"),
        "lashes": ("helper-l-eyelashes-2", "helper-r-eyelashes-2"),  # of the upper lids
        "teeth": ("helper-upper-teeth", "helper-lower-teeth"),
        "tongue": ("helper-tongue",),
        "tights": ("helper-tights",),
    }
    ids, extras, quads = [np.arange(n_body)], {}, {}
    start = n_body
    for name, members in groups.items():
        table = np.concatenate([source.groups[m].vertices for m in members])
        own, rows = np.unique(table, return_inverse=True)
        extras[name] = start + np.arange(len(own))
        quads[name] = rows.reshape(-1, 4).astype(np.int64)
        ids.append(own)
        start += len(own)
    every = np.concatenate(ids)
    points = source.vertices[every]
    mirror = _counterparts(points)
    bones = bone_weights(source)
    hand_ids = np.unique(body.vertices[hand_quads(source, body)])
    if len(hand_ids) != len(hand.v_template):
        raise ModelError(f"{len(hand_ids)} hand vertices; the hand model has another topology")
    return BodyCut(
        faces, texture, n_body, every, extras, quads, mirror, tuple(bones),
        np.stack([column[every] for column in bones.values()], axis=1), hand_ids,
    )  # fmt: skip


def populate_bodies(
    source: MakeHuman, cut: BodyCut, hand: ManoModel, n: int, *, rng: np.random.Generator
) -> Bodies:
    """Draw adults, take them to the zero pose and regress their joints."""
    bones = source.bones()
    ends = {(b, end): bones[b][end] for b in cut.bones for end in ("head", "tail")}
    mirror = _counterparts(source.vertices)
    needed = np.unique(np.concatenate([cut.ids, *ends.values()]))
    region = Region.of(np.union1d(needed, mirror[needed]), len(source.vertices))
    people, male = sample_bodies(source, region, n, rng=rng)
    people = 0.5 * (people + people[:, region.index[mirror[region.ids]]] * _MIRROR)
    at = {key: people[:, region.index[ids]].mean(axis=1) for key, ids in ends.items()}
    skin = people[:, region.index[cut.ids]]
    skin, heads, tips = _flat_arms(skin, at, cut, {b: bones[b]["parent"] for b in cut.bones})
    joints = _joints(heads)
    height = np.ptp(people[:, region.index[np.arange(cut.n_body)], 1], axis=1)
    factor = _stature(height, male)
    skin, joints, tips = (a * factor[:, None, None] for a in (skin, joints, tips))
    return _settle(skin, joints, tips, cut, hand, height * factor)


def _counterparts(points: Array) -> Ints:
    """Row of every point's mirror image, which must be there."""
    away, mirror = cKDTree(points).query(points * _MIRROR)
    if np.max(away) > 1e-9:
        raise ModelError(f"the base mesh is not symmetric: off by {np.max(away)} m")
    return np.asarray(mirror, dtype=np.int64)


def _flat_arms(
    skin: Array, at: dict[tuple[str, str], Array], cut: BodyCut, parents: dict[str, str]
) -> tuple[Array, dict[str, Array], Array]:
    """Turn the right arm's bones flat and mirror them; return skin, bone heads and fingertips."""
    chain = ("shoulder01", *CHAIN)
    heads = {b: at[f"{b}.R", "head"] for b in chain}
    tails = {b: at[f"{b}.R", "tail"] for b in chain}
    turns = flatten(heads, tails)
    swing = swing_between(
        heads["lowerarm01"] - heads["upperarm01"], np.tile([-1.0, 0, 0], (len(skin), 1))
    )
    blade = matrix_from_axis_angle(_BLADE_SHARE * axis_angle_from_matrix(swing))
    turns = {"shoulder01": blade} | turns
    placed = place(heads, {b: parents[f"{b}.R"].removesuffix(".R") for b in chain}, turns)
    rotations = np.stack(
        [np.tile(np.eye(3), (len(skin), 1, 1)), *(turns[b] for b in chain)], axis=1
    )
    moved = np.stack([placed[b] - _turn(turns[b], heads[b]) for b in chain], axis=1)
    moved = np.concatenate([np.zeros_like(moved[:, :1]), moved], axis=1)
    weights = cut.bone_weights[:, [cut.bones.index(f"{b}.R") for b in chain]]
    weights = np.column_stack([1 - weights.sum(axis=1), weights])
    ours = np.flatnonzero(weights[:, 0] < 1 - 1e-9)
    result = skin.copy()
    flat = dual_quaternion_skin(skin[:, ours], weights[ours], rotations, moved)
    result[:, ours] = flat
    result[:, cut.mirror[ours]] = flat * _MIRROR
    # a few vertices have weights of both arms, not quite alike
    result = 0.5 * (result + result[:, cut.mirror] * _MIRROR)
    new_heads = {b: at[b, "head"] for b in cut.bones}
    for bone, where in placed.items():
        new_heads[f"{bone}.R"], new_heads[f"{bone}.L"] = where, where * _MIRROR
    tips = [
        placed[b] + _turn(turns[b], tails[b] - heads[b]) for b in (f"finger{d}-3" for d in DIGITS)
    ]
    return result, new_heads, np.stack(tips, axis=1)


def _turn(rotation: Array, vectors: Array) -> Array:
    return np.asarray((rotation @ vectors[..., None])[..., 0])


def _joints(heads: dict[str, Array]) -> Array:
    """Joint positions (n, 75, 3) from bone heads."""
    result = {"jaw": heads["jaw"], "neck": heads["neck01"], "head": heads["head"]}
    result["pelvis"] = 0.5 * (heads["upperleg01.L"] + heads["upperleg01.R"])
    result["pelvis"] = result["pelvis"] + [0, _PELVIS_RISE_M, 0]
    for joint, bone in (("spine1", "spine04"), ("spine2", "spine03"), ("spine3", "spine02")):
        result[joint] = heads[bone]
    limbs = {
        "hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot", "collar": "clavicle",
        "shoulder": "upperarm01", "elbow": "lowerarm01", "wrist": "wrist", "eye": "eye",
    }  # fmt: skip
    for side, letter in (("left", "L"), ("right", "R")):
        for joint, bone in limbs.items():
            result[f"{side}_{joint}"] = heads[f"{bone}.{letter}"]
        ball = [heads[f"toe{k}-1.{letter}"] for k in (2, 3, 4)]
        result[f"{side}_foot"] = np.mean(ball, axis=0)
        for digit, finger in zip(DIGITS, FINGERS, strict=True):
            for k in (1, 2, 3):
                result[f"{side}_{finger}{k}"] = heads[f"finger{digit}-{k}.{letter}"]
        for digit, toe in enumerate(TOES, 1):
            for k in (1, 2):
                result[f"{side}_{toe}{k}"] = heads[f"toe{digit}-{k}.{letter}"]
    return np.stack([result[name] for name in SUPR75.names], axis=1)


def _stature(height: Array, male: NDArray[np.bool_]) -> Array:
    """Scale that gives men and women their mean and spread of stature."""
    wanted = np.empty_like(height)
    for sex, (mean, spread) in zip((male, ~male), STATURE_M, strict=True):
        h = height[sex]
        wanted[sex] = mean + (h - h.mean()) * spread / h.std()
    return np.asarray(wanted / height)


def _settle(
    skin: Array, joints: Array, tips: Array, cut: BodyCut, hand: ManoModel, stature: Array
) -> Bodies:
    regressor = _regressor(joints, skin[:, : cut.n_body], cut, hand)
    own = cut.hand_ids
    for _ in range(2):
        hands = np.einsum("kv,nvi->nki", hand.J_regressor, skin[:, own])
        flat, _, tips = straighten(skin[:, own], hands, tips, hand.weights)
        skin[:, own], skin[:, cut.mirror[own]] = flat, flat * _MIRROR
    pelvis = np.einsum("v,nvi->ni", regressor[0], skin[:, : cut.n_body])
    return Bodies(skin - pelvis[:, None], regressor, stature)


def _regressor(joints: Array, skin: Array, cut: BodyCut, hand: ManoModel) -> Array:
    """Fit right and middle rows; hands take the hand model's rows, left rows are mirrored."""
    result = np.zeros((len(SUPR75.names), cut.n_body))
    middle = [k for k, name in enumerate(SUPR75.names) if swapped_side(name) == name]
    right = [
        k for k, name in enumerate(SUPR75.names)
        if name.startswith("right_") and k not in _RIGHT_HAND
    ]  # fmt: skip
    fitted = [*middle, *right]
    result[fitted] = regress_joints(joints[:, fitted], skin)
    result[np.ix_(np.array(_RIGHT_HAND), cut.hand_ids)] = hand.J_regressor
    mirror = cut.mirror[: cut.n_body]
    result[middle] = 0.5 * (result[middle] + result[middle][:, mirror])
    for k, name in enumerate(SUPR75.names):
        if name.startswith("left_"):
            result[k] = result[SUPR75.index(swapped_side(name))][mirror]
    return result
