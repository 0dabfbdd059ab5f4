"""The right hand and arm cut out of MakeHuman's body, flat, for a population of adults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.digits import vary_digits
from synthgen.cc0.people import Region, sample_people
from synthgen.cc0.regressor import regress_joints
from synthgen.cc0.source import MakeHuman, Quads
from synthgen.cc0.unpose import DIGITS, dual_quaternion_skin, flatten, place
from synthgen.errors import ModelError
from synthgen.geometry.rotations import swing_between
from synthgen.geometry.topology import boundary_loops
from synthgen.models.joints import MANO16_PARENTS

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

HAND_COLOUR = (255, 29, 35)  # right hand in the segmentation image
CHAIN = (
    "upperarm01", "upperarm02", "lowerarm01", "lowerarm02", "wrist",
    *(f"metacarpal{k}" for k in range(1, 5)),
    *(f"finger{d}-{k}" for d in DIGITS for k in (1, 2, 3)),
)  # fmt: skip
_JOINT_BONES = ("wrist", *(f"finger{d}-{k}" for d in DIGITS for k in (1, 2, 3)))
UPPER_ARM_SHARE = 0.86  # of the upper arm that is kept
# Wrist joint to middle fingertip, metres: adults of both sexes (hand anthropometry).
HAND_LENGTH_M = (0.192, 0.0115)


@dataclass(frozen=True, eq=False)
class HandCut:
    """Topology of hand and arm: the hand's vertices first.

    ``triangles`` and ``texture`` are parallel; the first ``n_hand_faces`` belong to the hand.
    """

    ids: Ints
    n_hand: int
    triangles: Ints
    texture: Ints
    n_hand_faces: int
    weights: Array


@dataclass(frozen=True, eq=False)
class Population:
    """Flat hands of many subjects, wrist joint at the origin, metres."""

    vertices: Array
    joints: Array
    tips: Array
    elbows: Array
    regressor: Array


def cut_hand(source: MakeHuman) -> HandCut:
    """Select the right hand (by the segmentation image) and the arm up to the shoulder."""
    body = source.groups["body"]
    is_hand = hand_quads(source, body)
    weights = bone_weights(source)
    arm_share = sum(weights[f"{bone}.R"] for bone in CHAIN)
    shoulder, elbow = (_head(source, f"{b}.R") for b in ("upperarm01", "lowerarm01"))
    axis = elbow - shoulder
    along = (source.vertices - shoulder) @ axis / (axis @ axis)
    keep = (arm_share > 0.5) & (along > 1 - UPPER_ARM_SHARE)
    is_arm = keep[body.vertices].all(axis=1) & ~is_hand
    hand_ids = np.unique(body.vertices[is_hand])
    arm_ids = np.setdiff1d(np.unique(body.vertices[is_arm]), hand_ids)
    ids = np.concatenate([hand_ids, arm_ids])
    index = Region.of(ids, len(source.vertices)).index
    hand, hand_tex = triangles(body, is_hand)
    arm, arm_tex = triangles(body, is_arm)
    joined = index[np.concatenate([hand, arm])]
    loops = boundary_loops(joined)
    if len(loops) != 1:
        raise ModelError(f"the cut arm has {len(loops)} open ends; expected 1: {map(len, loops)}")
    bones = np.stack([weights[f"{bone}.R"][ids] for bone in CHAIN], axis=1)
    bones[:, 0] += 1 - bones.sum(axis=1)
    return HandCut(
        ids, len(hand_ids), joined, np.concatenate([hand_tex, arm_tex]), len(hand), bones
    )


def hand_quads(source: MakeHuman, body: Quads) -> NDArray[np.bool_]:
    """Tell which of the body's quads the segmentation image paints as right hand, (n,)."""
    image = source.image("segmentation/body_parts_segmentation.png")
    middle = source.texture[body.texture].mean(axis=1)
    size = image.shape[0]
    rows = np.clip(np.round((1 - middle[:, 1]) * size).astype(int), 0, size - 1)
    columns = np.clip(np.round(middle[:, 0] * size).astype(int), 0, size - 1)
    return np.asarray(np.all(image[rows, columns] == HAND_COLOUR, axis=1))


def bone_weights(source: MakeHuman) -> dict[str, Array]:
    """Return each bone's weights over all vertices; they sum to 1."""
    table = {}
    for bone, rows in source.skinning().items():
        column = np.zeros(len(source.vertices))
        column[rows[:, 0].astype(np.int64)] = rows[:, 1]
        table[bone] = column
    total = np.maximum(sum(table.values()), 1e-9)
    return {bone: column / total for bone, column in table.items()}


def _head(source: MakeHuman, bone: str) -> Array:
    return np.asarray(source.vertices[source.bones()[bone]["head"]].mean(axis=0))


def triangles(quads: Quads, chosen: NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """Split quads along their first diagonal, keeping both triangles of a quad together."""
    split = [[0, 1, 2], [0, 2, 3]]
    vertices = quads.vertices[chosen][:, split].reshape(-1, 3)
    return vertices, quads.texture[chosen][:, split].reshape(-1, 3)


def populate(source: MakeHuman, cut: HandCut, n: int, *, rng: np.random.Generator) -> Population:
    """Draw adults, flatten their hands and regress their joints.

    Regressor and straightening are iterated: joints are what the regressor says, and the fingers
    are straight with respect to those.
    """
    bones = source.bones()
    ends = {(bone, end): bones[f"{bone}.R"][end] for bone in CHAIN for end in ("head", "tail")}
    region = Region.of(np.unique(np.concatenate([cut.ids, *ends.values()])), len(source.vertices))
    people = sample_people(source, region, n, rng=rng)
    at = {key: people[:, region.index[ids]].mean(axis=1) for key, ids in ends.items()}
    heads = {bone: at[bone, "head"] for bone in CHAIN}
    tails = {bone: at[bone, "tail"] for bone in CHAIN}
    parents = {b: bones[f"{b}.R"]["parent"].removesuffix(".R") for b in CHAIN}
    turns = flatten(heads, tails)
    placed = place(heads, parents, turns)
    rotations = np.stack([turns[b] for b in CHAIN], axis=1)
    moved = np.stack([placed[b] - _turn(turns[b], heads[b]) for b in CHAIN], axis=1)
    skin = people[:, region.index[cut.ids]]
    flat = dual_quaternion_skin(skin, cut.weights, rotations, moved)
    joints = np.stack([placed[b] for b in _JOINT_BONES], axis=1)
    tips = np.stack([_tip(f"finger{d}-3", tails, placed, heads, turns) for d in DIGITS], axis=1)
    return _settle(flat, joints, tips, placed["lowerarm01"], hand_weights(cut), cut.n_hand, rng)


def _turn(rotation: Array, vectors: Array) -> Array:
    return np.asarray((rotation @ vectors[..., None])[..., 0])


def _tip(
    bone: str, tails: dict[str, Array], placed: dict[str, Array], heads: dict[str, Array],
    turns: dict[str, Array],
) -> Array:  # fmt: skip
    return np.asarray(placed[bone] + _turn(turns[bone], tails[bone] - heads[bone]))


def _settle(
    flat: Array, joints: Array, tips: Array, elbows: Array, weights: Array, n_hand: int,
    rng: np.random.Generator,
) -> Population:  # fmt: skip
    origin = joints[:, :1].copy()
    flat, joints, tips, elbows = (
        flat - origin, joints - origin, tips - origin, elbows - origin[:, 0],
    )  # fmt: skip
    flat, joints, tips = vary_digits(flat, joints, tips, weights, rng=rng)
    size = _size_factor(np.linalg.norm(tips[:, 1], axis=1))[:, None]
    flat, joints, tips = (a * size[..., None] for a in (flat, joints, tips))
    elbows = elbows * size
    for _ in range(2):
        regressor = regress_joints(joints, flat[:, :n_hand])
        joints = np.einsum("kv,nvi->nki", regressor, flat[:, :n_hand])
        flat, joints, tips = straighten(flat, joints, tips, weights)
    joints = np.einsum("kv,nvi->nki", regressor, flat[:, :n_hand])
    shift = joints[:, :1].copy()
    return Population(flat - shift, joints - shift, tips - shift, elbows - shift[:, 0], regressor)


def _size_factor(length: Array) -> Array:
    """Scale that gives the population's hand lengths their mean and spread."""
    mean, spread = HAND_LENGTH_M
    return np.asarray((mean + (length - length.mean()) * spread / length.std()) / length)


def straighten(
    vertices: Array, joints: Array, tips: Array, weights: Array
) -> tuple[Array, Array, Array]:
    """Turn the phalanges of the four fingers into one line in the palm's plane."""
    n = len(vertices)
    turn = np.tile(np.eye(3), (n, 16, 1, 1))
    place_ = joints.copy()
    new_tips = tips.copy()
    for finger in range(4):
        first = 1 + 3 * finger
        points = [joints[:, first + k] for k in range(3)] + [tips[:, finger]]
        goal = points[3] - points[0]
        goal[:, 1] = 0
        for k in range(3):
            j = first + k
            turn[:, j] = swing_between(points[k + 1] - points[k], goal)
            if k:
                p = MANO16_PARENTS[j]
                place_[:, j] = place_[:, p] + _turn(turn[:, p], joints[:, j] - joints[:, p])
        new_tips[:, finger] = place_[:, j] + _turn(turn[:, j], tips[:, finger] - joints[:, j])
    moved = place_ - _turn(turn, joints)
    return dual_quaternion_skin(vertices, weights, turn, moved), place_, new_tips


def hand_weights(cut: HandCut) -> Array:
    """Return (S, 16) MANO-form weights, at most four per vertex; arm vertices follow the root."""
    column = {bone: k for k, bone in enumerate(CHAIN)}
    weights = np.zeros((len(cut.ids), 16))
    for j, bone in enumerate(_JOINT_BONES[1:], start=1):
        weights[:, j] = cut.weights[:, column[bone]]
    weights[:, 0] = 1 - weights[:, 1:].sum(axis=1)
    fourth = np.sort(weights, axis=1)[:, -4]
    weights[weights < np.maximum(fourth, 1e-3)[:, None]] = 0
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
