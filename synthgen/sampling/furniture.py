"""What fills a room or open ground, mostly where the first camera looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from synthgen.sampling.appearance import linear_rgb_from_lab, rounded
from synthgen.sampling.lighting import room_box
from synthgen.sampling.props import make_thing, small_thing
from synthgen.sampling.stage import Stage
from synthgen.scene import Background, Thing

Array = NDArray[np.float64]

STANDING = ("cylinder", "ball", "bottle", "bowl")


def furniture(
    stage: Stage, background: Background, *, rng: np.random.Generator
) -> tuple[Thing, ...]:
    """Draw what fills a room or open ground, mostly where the first camera looks."""
    room = background.kind == "room"
    placed: list[Thing] = []
    for number in range(int(rng.integers(12, 20))):
        spot = _look(stage, rng, wide=number % 3 == 2)
        group = _indoors(background, spot, rng) if room else _outdoors(spot, rng)
        apart = not any(_overlap(thing, other) for thing in group[:1] for other in placed)
        placed += [thing for thing in group if apart and stage.clear(thing)]
    return tuple(placed)


def _overlap(one: Thing, other: Thing) -> bool:
    """Tell whether the boxes around two things, as if neither were turned, meet."""
    gap = np.abs(np.array(one.position_m) - np.array(other.position_m))
    return bool(np.all(gap < (np.array(one.size_m) + np.array(other.size_m)) / 2))


def _look(stage: Stage, rng: np.random.Generator, *, wide: bool) -> tuple[Array, Array]:
    """Return a ray (origin, unit direction) within the first picture; anywhere around if wide."""
    camera = stage.cameras[0]
    if wide:
        direction = rng.standard_normal(3) * [1.0, 0.4, 1.0]
    else:
        pixel = rng.uniform(-0.1, 1.1, 2) * [camera.width, camera.height]
        local = np.array(
            [(pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy, 1.0]
        )
        direction = camera.T[:3, :3] @ local
    return camera.position, direction / np.linalg.norm(direction)


def _indoors(room: Background, ray: tuple[Array, Array], rng: np.random.Generator) -> list[Thing]:
    """Draw a group of things where a ray meets the room: against a wall, or on the floor."""
    low, high = room_box(room)
    origin, direction = ray
    with np.errstate(divide="ignore"):
        reach = np.where(direction > 0, high - origin, low - origin) / direction
    axis = int(np.argmin(np.where(np.isfinite(reach), reach, np.inf)))
    spot = origin + reach[axis] * direction
    if axis == 1:
        return _on_floor(spot, rng) if direction[1] < 0 else []
    inward = -np.sign(direction[axis])
    kind = rng.random()
    if kind < 0.3 or spot[1] > 2.0:
        return _picture(spot, axis, inward, rng)
    if kind < 0.65:
        return _shelf(spot, axis, inward, rng)
    return _cupboard(spot, axis, inward, rng)


def _slab(axis: int, depth: float, height: float, width: float) -> Array:
    """Extents of a box against a wall across ``axis``."""
    return np.array([depth, height, width] if axis == 0 else [width, height, depth])


def _against(spot: Array, axis: int, inward: float, depth: float) -> Array:
    place = spot.copy()
    place[axis] += inward * (depth / 2 + 0.002)
    return place


def _picture(spot: Array, axis: int, inward: float, rng: np.random.Generator) -> list[Thing]:
    width, height = rng.uniform(0.2, 0.8, 2)
    frame = make_thing("furniture", "box", _against(spot, axis, inward, 0.02),
                   _slab(axis, 0.02, height, width), 0.0, rng, dull=True)  # fmt: skip
    inside = make_thing("furniture", "box", _against(spot, axis, inward, 0.026),
                    _slab(axis, 0.026, height - 0.06, width - 0.06), 0.0, rng)  # fmt: skip
    return [frame, inside]


def _shelf(spot: Array, axis: int, inward: float, rng: np.random.Generator) -> list[Thing]:
    """Draw a board on the wall with books, bottles and bowls on it."""
    width, depth = float(rng.uniform(0.5, 1.2)), 0.2
    place = _against(spot, axis, inward, depth)
    board = make_thing(
        "furniture", "box", place, _slab(axis, depth, 0.022, width), 0.0, rng, dull=True
    )
    group, reach = [board], -width / 2 + 0.03
    while reach < width / 2 - 0.08 and len(group) < 9:
        if rng.random() < 0.65:
            step, height = rng.uniform(0.015, 0.05), rng.uniform(0.16, 0.28)
            shape, size = "box", _slab(axis, 0.15, height, step)
        else:
            step, height = rng.uniform(0.07, 0.11), rng.uniform(0.08, 0.26)
            shape, size = STANDING[int(rng.integers(4))], np.array([step, height, step])
        where = place.copy()
        where[2 - axis] += reach + step / 2
        where[1] += 0.011 + height / 2
        group.append(make_thing("furniture", shape, where, size, 0.0, rng))
        reach += step + (0.003 if shape == "box" else rng.uniform(0.02, 0.12))
    return group


def _cupboard(spot: Array, axis: int, inward: float, rng: np.random.Generator) -> list[Thing]:
    """Draw a chest or cupboard on the floor, doors and a few things on top."""
    width, depth = float(rng.uniform(0.5, 1.3)), float(rng.uniform(0.3, 0.5))
    height = float(rng.uniform(0.6, 1.9))
    place = _against(np.array([spot[0], height / 2, spot[2]]), axis, inward, depth)
    body = make_thing(
        "furniture", "box", place, _slab(axis, depth, height, width), 0.0, rng, dull=True
    )
    group, doors = [body], int(rng.integers(1, 4))
    for k in range(doors):
        door = place.copy()
        door[axis] += inward * (depth / 2 + 0.008)
        door[2 - axis] += (k + 0.5) * width / doors - width / 2
        size = _slab(axis, 0.016, height - 0.06, width / doors - 0.02)
        leaf = make_thing("furniture", "box", door, size, 0.0, rng, dull=True)
        group.append(replace(leaf, colour_rgb=body.accent_rgb, accent_rgb=body.colour_rgb))
    for _ in range(int(rng.integers(0, 3))):
        small = small_thing(rng)
        where = place.copy()
        where[2 - axis] += rng.uniform(-0.4, 0.4) * width
        where[1] = height + small.size_m[1] / 2
        group.append(replace(small, position_m=rounded(where)))
    return group


def _on_floor(spot: Array, rng: np.random.Generator) -> list[Thing]:
    """Draw a box, a stool, a pot or a rug."""
    kind = int(rng.integers(4))
    a, b = rng.uniform(0.25, 0.6, 2)
    turn = float(rng.uniform(0, np.pi))
    if kind == 0:
        size = np.array([4 * a, 0.012, 4 * b])
        return [make_thing("furniture", "box", _standing(spot, 0.012), size, turn, rng)]
    shape = ("box", "cylinder", "bowl")[kind - 1]
    size = np.array([a, b, a])
    return [make_thing("furniture", shape, _standing(spot, b), size, turn, rng)]


def _standing(spot: Array, height: float) -> Array:
    return np.array([spot[0], height / 2, spot[2]])


def _outdoors(ray: tuple[Array, Array], rng: np.random.Generator) -> list[Thing]:
    """Trunks with crowns, bushes, stones, fences near; houses farther away."""
    origin, direction = ray
    flat = np.array([direction[0], 0.0, direction[2]])
    flat /= max(float(np.linalg.norm(flat)), 1e-6)
    far = float(rng.uniform(1.6, 18.0))
    spot = np.array([origin[0], 0.0, origin[2]]) + flat * far
    turn = float(rng.uniform(0, np.pi))
    if far > 9:
        size = rng.uniform([4, 2.5, 4], [10, 8, 9])
        return [
            make_thing("furniture", "box", _standing(spot, size[1]), size, turn, rng, dull=True)
        ]
    kind = int(rng.integers(4))
    if kind == 0:
        girth, height = rng.uniform(0.12, 0.4), rng.uniform(2.5, 5)
        trunk = make_thing("furniture", "cylinder", _standing(spot, height),
                       np.array([girth, height, girth]), turn, rng, dull=True)  # fmt: skip
        crown = rng.uniform([1.2, 1.0, 1.2], [3, 3, 3])
        above = np.array([spot[0], height + 0.2 * crown[1], spot[2]])
        return [trunk, _leafy(make_thing("furniture", "ball", above, crown, turn, rng), rng)]
    if kind == 1:
        size = rng.uniform([0.5, 0.4, 0.5], [1.8, 1.4, 1.8])
        return [
            _leafy(make_thing("furniture", "ball", _standing(spot, size[1]), size, turn, rng), rng)
        ]
    if kind == 2:
        size = rng.uniform([0.2, 0.15, 0.2], [0.8, 0.6, 0.8])
        return [
            make_thing(
                "furniture", "ball", _standing(spot, 0.7 * size[1]), size, turn, rng, dull=True
            )
        ]
    size = np.array([rng.uniform(1.5, 4), rng.uniform(0.8, 1.8), 0.05])
    return [make_thing("furniture", "box", _standing(spot, size[1]), size, turn, rng, dull=True)]


def _leafy(thing: Thing, rng: np.random.Generator) -> Thing:
    lab = np.array([rng.uniform(28, 55), rng.uniform(-28, -10), rng.uniform(18, 38)])
    return replace(
        thing,
        colour_rgb=rounded(linear_rgb_from_lab(lab)),
        accent_rgb=rounded(linear_rgb_from_lab(lab * [0.5, 0.8, 0.8])),
        roughness=0.9,
    )
