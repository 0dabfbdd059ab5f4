"""Single things and their colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.sampling.appearance import linear_rgb_from_lab, rounded
from synthgen.scene import Thing
from synthgen.scene.description import Vec3

Array = NDArray[np.float64]


def small_thing(rng: np.random.Generator) -> Thing:
    """Draw a thing of a table's size, at the origin: mug, bottle, book, bowl, ball, box, pen."""
    kind = ("mug", "bottle", "book", "bowl", "ball", "box", "pen")[int(rng.integers(7))]
    a, b = rng.uniform(0.8, 1.2, 2)
    shape, size = {
        "mug": ("cylinder", (0.08 * a, 0.095 * b, 0.08 * a)),
        "bottle": ("bottle", (0.075 * a, 0.24 * b, 0.075 * a)),
        "book": ("box", (0.15 * a, 0.03 * b, 0.21 * a)),
        "bowl": ("bowl", (0.15 * a, 0.06 * b, 0.15 * a)),
        "ball": ("ball", (0.07 * a, 0.07 * a, 0.07 * a)),
        "box": ("box", (0.12 * a, 0.09 * b, 0.16 * a)),
        "pen": ("box", (0.14 * a, 0.008, 0.008)),
    }[kind]
    return make_thing(
        "furniture", shape, np.zeros(3), np.array(size), float(rng.uniform(0, np.pi)), rng
    )


def make_thing(
    role: str, shape: str, place: Array, size: Array, turn: float, rng: np.random.Generator,
    *, dull: bool = False,
) -> Thing:  # fmt: skip
    """Make a thing of given role, shape, centre, extents and turn about y; draw its colours."""
    colour, accent = sample_colours(rng, dull=dull)
    return Thing(
        role=role,  # type: ignore[arg-type]
        shape=shape,  # type: ignore[arg-type]
        position_m=rounded(place),
        turn=rounded(np.array([0.0, turn, 0.0])),
        size_m=rounded(size),
        colour_rgb=colour,
        accent_rgb=accent,
        roughness=round(float(rng.uniform(0.2, 0.9)), 4),
        seed=int(rng.integers(2**31)),
    )


def sample_colours(rng: np.random.Generator, *, dull: bool = False) -> tuple[Vec3, Vec3]:
    """Mostly woods, whites, greys and blacks; sometimes a strong colour."""
    strong = rng.random() < (0.08 if dull else 0.3)
    chroma, hue = (rng.uniform(18, 45), rng.uniform(0, 2 * np.pi)) if strong else (
        rng.uniform(2, 26), rng.normal(1.15, 0.35))  # fmt: skip
    lab = np.array([rng.uniform(18, 85), chroma * np.cos(hue), chroma * np.sin(hue)])
    other = lab + np.array([rng.normal(0, 18), *rng.normal(0, 8, 2)])
    other[0] = np.clip(other[0], 8, 92)
    return rounded(linear_rgb_from_lab(lab)), rounded(linear_rgb_from_lab(other))
