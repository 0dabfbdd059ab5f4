"""From MakeHuman's A-pose with half curled fingers to MANO's zero pose.

The arm is stretched along x, the palm turned down, the fingers straightened; skin follows by
dual-quaternion blending, which keeps the volume of the twisted forearm.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthgen.geometry.normals import unit
from synthgen.geometry.rotations import matrix_from_axis_angle, swing_between

Array = NDArray[np.float64]

# MakeHuman's digits in MANO order: index, middle, pinky, ring, thumb.
DIGITS = (2, 3, 5, 4, 1)
_SIDE = np.array([-1.0, 0.0, 0.0])  # where a right arm points


def flatten(heads: dict[str, Array], tails: dict[str, Array]) -> dict[str, Array]:
    """Return the world rotation (n, 3, 3) per bone that takes everybody to the zero pose.

    Parameters
    ----------
    heads, tails : dict of (n, 3)
        Bone ends by bone name (without the side's suffix), metres.
    """
    n = len(heads["wrist"])
    out = np.tile(_SIDE, (n, 1))
    upper = swing_between(heads["lowerarm01"] - heads["upperarm01"], out)
    lower = _then(heads["wrist"] - heads["lowerarm01"], out, upper)
    hand = _hand_frame(heads)
    twist = _twist_about_x(hand @ lower.transpose(0, 2, 1))
    x = np.tile([1.0, 0.0, 0.0], (n, 1))
    turns = {
        "upperarm01": upper,
        "upperarm02": matrix_from_axis_angle(x * (0.15 * twist)[:, None]) @ upper,
        "lowerarm01": matrix_from_axis_angle(x * (0.45 * twist)[:, None]) @ lower,
        "lowerarm02": matrix_from_axis_angle(x * (0.85 * twist)[:, None]) @ lower,
        "wrist": hand,
        **{f"metacarpal{k}": hand for k in range(1, 5)},
    }
    for digit in DIGITS:
        points = [heads[f"finger{digit}-{k}"] for k in (1, 2, 3)] + [tails[f"finger{digit}-3"]]
        for k, turn in enumerate(_straighten(points, hand, thumb=digit == 1)):
            turns[f"finger{digit}-{k + 1}"] = turn
    return turns


def _then(direction: Array, target: Array, first: Array) -> Array:
    """Follow ``first`` by the swing that takes the turned direction to the target."""
    return swing_between(_turn(first, direction), target) @ first


def _turn(rotation: Array, vectors: Array) -> Array:
    return np.asarray((rotation @ vectors[..., None])[..., 0])


def _hand_frame(heads: dict[str, Array]) -> Array:
    """Rotation that lays the metacarpals along -x and across z, palm down."""
    along = unit(heads["finger3-1"] - heads["wrist"])
    across = heads["finger2-1"] - heads["finger5-1"]
    across = unit(across - np.sum(across * along, axis=1, keepdims=True) * along)
    frame = np.stack([along, across, np.cross(along, across)], axis=-1)
    goal = np.stack([_SIDE, [0.0, 0.0, 1.0], np.cross(_SIDE, [0.0, 0.0, 1.0])], axis=-1)
    return np.asarray(goal @ frame.transpose(0, 2, 1))


def _twist_about_x(rotation: Array) -> Array:
    return np.asarray(
        np.arctan2(rotation[:, 2, 1] - rotation[:, 1, 2], rotation[:, 1, 1] + rotation[:, 2, 2])
    )


def _straighten(points: list[Array], hand: Array, *, thumb: bool) -> list[Array]:
    """Return turns of three phalanges: fingers into the palm's plane, thumb tips into line."""
    if thumb:
        middle, last = points[2] - points[1], points[3] - points[2]
        return [hand, hand, _then(last, _turn(hand, middle), hand)]
    goal = _turn(hand, points[3] - points[0])
    goal[:, 1] = 0.0
    turns, current = [], hand
    for a, b in itertools.pairwise(points):
        current = _then(b - a, goal, current)
        turns.append(current)
    return turns


def place(
    heads: dict[str, Array], parents: dict[str, str], turns: dict[str, Array]
) -> dict[str, Array]:
    """Chain the turned bones: new head (n, 3) per bone; the first bone stays where it is."""
    placed: dict[str, Array] = {}
    for name in turns:
        parent = parents[name]
        if parent not in placed:
            placed[name] = heads[name]
            continue
        placed[name] = placed[parent] + _turn(turns[parent], heads[name] - heads[parent])
    return placed


def dual_quaternion_skin(
    vertices: Array, weights: Array, rotations: Array, translations: Array
) -> Array:
    """Blend rigid motions by dual quaternions (Kavan 2007).

    Parameters
    ----------
    vertices : (n, V, 3)
    weights : (V, B)
    rotations : (n, B, 3, 3)
    translations : (n, B, 3)
        ``x' = R x + t`` per bone.

    Returns
    -------
    (n, V, 3) float64
    """
    turns, moves = dual_quaternion_motions(weights, rotations, translations)
    return np.stack(
        [Rotation.from_quat(q).apply(v) + t for q, v, t in zip(turns, vertices, moves, strict=True)]
    )


def dual_quaternion_motions(
    weights: Array, rotations: Array, translations: Array
) -> tuple[Array, Array]:
    """Blended rigid motion per vertex: unit quaternions (n, V, 4) and translations (n, V, 3)."""
    shape = rotations.shape[:2]
    q = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat().reshape(*shape, 4)
    dual = 0.5 * _multiply(np.concatenate([translations, np.zeros((*shape, 1))], axis=-1), q)
    pivot = q[:, weights.argmax(axis=1)]
    turns = np.empty((len(q), len(weights), 4))
    moves = np.empty((len(q), len(weights), 3))
    for i in range(len(q)):
        signed = weights * np.where(pivot[i] @ q[i].T < 0, -1.0, 1.0)
        real, extra = signed @ q[i], signed @ dual[i]
        length = np.linalg.norm(real, axis=1, keepdims=True)
        turns[i], extra = real / length, extra / length
        moves[i] = 2 * _multiply(extra, turns[i] * [-1, -1, -1, 1])[:, :3]
    return turns, moves


def _multiply(a: Array, b: Array) -> Array:
    """Hamilton product of quaternions (..., 4), scalar last."""
    v, w = a[..., :3], a[..., 3:]
    u, s = b[..., :3], b[..., 3:]
    vector = w * u + s * v + np.cross(v, u)
    scalar = w * s - np.sum(v * u, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)
