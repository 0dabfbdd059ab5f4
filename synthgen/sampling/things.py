"""What the hand rests on, and what is between it and the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.geometry.cameras import to_camera
from synthgen.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from synthgen.sampling.appearance import rounded
from synthgen.sampling.props import make_thing, sample_colours, small_thing
from synthgen.sampling.stage import CLEARANCE_M, Stage
from synthgen.scene import Thing
from synthgen.scene.solids import mesh_of

Array = NDArray[np.float64]

TRIES = 12
MOST_BOXES, MOST_TURNED = 32, 16


def support(stage: Stage, *, rng: np.random.Generator) -> tuple[Thing, ...]:
    """Draw a table under the lowest point in the picture, and what stands on it; or nothing.

    The table's top touches the hand or arm. There is none where a camera looks from below it, or
    where it would lie far beneath the hand.
    """
    low = float(stage.in_frame()[:, 1].min())
    far_below = float(stage.hand[:, 1].min()) - low > 0.12
    too_low = min(camera.position[1] for camera in stage.cameras) < low + 0.08
    size = rng.uniform(0.9, 1.6), float(rng.uniform(0.025, 0.05)), rng.uniform(0.7, 1.1)
    turn = float(rng.uniform(0, np.pi))
    shift = rng.uniform(-0.2, 0.2, 2)
    colours, seed = sample_colours(rng, dull=True), int(rng.integers(2**31))
    roughness = float(rng.uniform(0.25, 0.8))
    if far_below or too_low:
        return ()
    middle = stage.hand.mean(axis=0)
    top = low - 0.0005
    table = Thing(
        role="support",
        shape="box",
        position_m=rounded(
            np.array([middle[0] + shift[0], top - size[1] / 2, middle[2] + shift[1]])
        ),
        turn=rounded(np.array([0.0, turn, 0.0])),
        size_m=rounded(np.array(size)),
        colour_rgb=colours[0],
        accent_rgb=colours[1],
        roughness=round(roughness, 4),
        seed=seed,
    )
    return (table, *_on_top(stage, table, top, rng))


def _on_top(stage: Stage, table: Thing, top: float, rng: np.random.Generator) -> list[Thing]:
    """Small things that stand on a table, around the hand and behind it."""
    placed: list[Thing] = []
    rotation = matrix_from_axis_angle(np.array(table.turn))
    for _ in range(int(rng.integers(2, 7))):
        for _ in range(TRIES):
            thing = small_thing(rng)
            reach = np.array([table.size_m[0], 0, table.size_m[2]]) / 2 - 0.06
            spot = np.array(table.position_m) + rotation @ (rng.uniform(-1, 1, 3) * reach)
            spot[1] = top + thing.size_m[1] / 2
            thing = replace(thing, position_m=rounded(spot))
            if stage.clear(thing) and all(_apart(thing, other) for other in placed):
                placed.append(thing)
                break
    return placed


def _apart(one: Thing, other: Thing) -> bool:
    gap = np.array(one.position_m) - np.array(other.position_m)
    reach = (max(one.size_m[0], one.size_m[2]) + max(other.size_m[0], other.size_m[2])) / 2
    return bool(np.hypot(gap[0], gap[2]) > reach)


def occluder(stage: Stage, *, rng: np.random.Generator) -> tuple[Thing, ...]:
    """Draw one thing between the first camera and the hand; or nothing where none fits."""
    camera = stage.cameras[0]
    z = to_camera(camera, stage.hand)[:, 2]
    tree = cKDTree(stage.surface)
    for _ in range(TRIES):
        target = stage.hand[int(rng.integers(len(stage.hand)))]
        share = rng.uniform(0.45, 0.85)
        place = camera.position + share * (target - camera.position)
        width = float(rng.uniform(0.1, 0.3)) * float(np.ptp(stage.hand @ camera.T[:3, 0])) * share
        shape, size = _rod_or_block(width, rng)
        turn = axis_angle_from_matrix(matrix_from_axis_angle(rng.standard_normal(3)))
        if shape in ("bottle", "cylinder", "bowl") and rng.random() < 0.6:
            turn = np.array([0.0, rng.uniform(0, np.pi), 0.0])
        thing = replace(
            make_thing("occluder", shape, place, size, 0.0, rng), turn=rounded(np.asarray(turn))
        )
        points = mesh_of(thing).vertices
        near = to_camera(camera, points)[:, 2]
        if near.max() < z.min() - 0.004 and near.min() > 0.06:
            clear = stage.clear(thing, in_view=True)
            if clear and np.min(tree.query(points)[0]) > CLEARANCE_M:
                return (thing,)
    return ()


def _rod_or_block(width: float, rng: np.random.Generator) -> tuple[str, Array]:
    kind = int(rng.integers(5))
    a = float(rng.uniform(0.8, 1.3))
    if kind == 0:
        return "cylinder", np.array([0.35 * width, 12 * width, 0.35 * width])
    if kind == 1:
        return "bottle", np.array([width, 3.2 * a * width, width])
    if kind == 2:
        return "ball", np.array([1.3 * width, 1.3 * width, 1.3 * width])
    if kind == 3:
        return "box", np.array([1.5 * width, 0.2 * width, 2.1 * width])
    return "cylinder", np.array([1.3 * width, 1.5 * a * width, 1.3 * width])


def within_slots(things: tuple[Thing, ...]) -> tuple[Thing, ...]:
    """Keep as many things as a renderer has slots for, occluders and supports first."""
    order = {"occluder": 0, "support": 1, "furniture": 2}
    kept: list[Thing] = []
    left = {True: MOST_BOXES, False: MOST_TURNED}
    for thing in sorted(things, key=lambda t: order[t.role]):
        box = thing.shape == "box"
        if left[box] > 0:
            left[box] -= 1
            kept.append(thing)
    return tuple(kept)
