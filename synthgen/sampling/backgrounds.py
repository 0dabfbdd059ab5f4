"""Backgrounds: walls, rooms, open ground, the user's pictures, nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.sampling.appearance import linear_rgb_from_lab, rounded
from synthgen.scene import Background, Picture
from synthgen.scene.description import Vec3

Array = NDArray[np.float64]


def sample_background(
    kind: str,
    centre: Array,
    behind_m: float,
    eyes: Array,
    *,
    rng: np.random.Generator,
    picture: Picture | None = None,
) -> Background:
    """Draw the background.

    Parameters
    ----------
    kind : {"plain", "procedural", "room", "empty", "outdoor", "photo"}
    centre : (3,)
        World point that the first camera looks at, metres.
    behind_m : float
        How far subjects reach behind ``centre`` along the optical axis, metres.
    eyes : (n, 3)
        Cameras, world, metres; a room must hold them.
    rng : numpy.random.Generator
    picture : Picture or None
        What kind ``photo`` shows.
    """
    camera_m = float(np.linalg.norm(eyes - centre, axis=1).max())
    room = kind == "room"
    distance = max(1.0, camera_m + 0.1, behind_m + 0.2) if room else behind_m
    # Half of the walls are near enough for the hand to cast its shadow there.
    near = 0.05 + 0.75 * rng.random() ** 2
    stretch = np.abs(rng.normal(0, 0.5, 2))
    top = max(float(eyes[:, 1].max()) + 0.15, centre[1] + 0.5, float(rng.uniform(2.3, 2.9)))
    return Background(
        kind=kind,  # type: ignore[arg-type]  # checked by the schema
        colour_rgb=_wall_colour(rng),
        accent_rgb=_wall_colour(rng),
        seed=int(rng.integers(2**31)),
        distance_m=round(float(distance + near), 6),
        centre_m=rounded(centre),
        ceiling_m=round(top, 6),
        stretch_m=(round(float(stretch[0]), 6), round(float(stretch[1]), 6)),
        file=picture,
        crop=(round(float(rng.random()), 6), round(float(rng.random()), 6)),
    )


def _wall_colour(rng: np.random.Generator) -> Vec3:
    lab = np.array([rng.uniform(20, 88), rng.normal(0, 7), rng.normal(3, 10)])
    return rounded(linear_rgb_from_lab(lab))
