"""A population of adults: MakeHuman morphs with unimodal distributions of our own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.source import (
    AGES,
    ANCESTRIES,
    GENDERS,
    HEIGHTS,
    MUSCLES,
    PROPORTIONS,
    WEIGHTS,
    MakeHuman,
    Target,
)

Array = NDArray[np.float64]
# Local morphs of the right hand and arm, and the standard deviation of their strength.
LOCAL = {
    "hands/r-hand-fingers-length": 0.10,
    "hands/r-hand-scale": 0.12,
    "hands/r-hand-fingers-diameter": 0.15,
    "hands/r-hand-fingers-distance": 0.12,
    "arms/r-lowerarm-fat": 0.2,
    "arms/r-lowerarm-muscle": 0.2,
}


@dataclass(frozen=True, eq=False)
class Region:
    """The vertices that matter (the arm, its joint cubes), and their index by original id."""

    ids: NDArray[np.int64]
    index: NDArray[np.int64]

    @staticmethod
    def of(ids: NDArray[np.int64], n_vertices: int) -> Region:
        """Build from original vertex ids."""
        index = np.full(n_vertices, -1, dtype=np.int64)
        index[ids] = np.arange(len(ids))
        return Region(ids, index)


def sample_people(source: MakeHuman, region: Region, n: int, *, rng: np.random.Generator) -> Array:
    """Draw n adults and return their region's vertices (n, len(region.ids), 3), metres."""
    vertices = np.tile(source.vertices[region.ids], (n, 1, 1))
    words = traits(n, rng)
    for key, target in source.macro_targets().items():
        weight = np.prod([words[word] for word in key], axis=0)
        _add(vertices, region, target, weight)
    for name, sigma in LOCAL.items():
        strength = np.clip(rng.normal(0, sigma, n), -0.6, 0.6)
        _add(vertices, region, source.target(f"{name}-decr"), np.maximum(-strength, 0))
        _add(vertices, region, source.target(f"{name}-incr"), np.maximum(strength, 0))
    return vertices


def traits(n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Interpolation weights (n,) of every word in the morphs' names; all unimodal in 0..1."""
    words: dict[str, Array] = {}
    male = rng.random(n) < 0.5
    gender = np.where(male, rng.beta(2, 12, n), 1 - rng.beta(2, 12, n))
    words.update(between(gender, GENDERS))
    words.update(between(rng.beta(1.5, 3, n), AGES[2:]))
    words.update(between(rng.beta(5, 5, n), MUSCLES))
    words.update(between(rng.beta(4, 5, n), WEIGHTS))
    words.update(between(rng.beta(7, 7, n), HEIGHTS))
    words.update(between(rng.beta(4, 4, n), PROPORTIONS))
    mixture = rng.dirichlet([0.8, 0.8, 0.8], n)
    words.update({name: mixture[:, k] for k, name in enumerate(ANCESTRIES)})
    return words


def between(x: Array, words: tuple[str, ...]) -> dict[str, Array]:
    """Linear interpolation weights of words that lie evenly along 0..1."""
    t = x * (len(words) - 1)
    return {word: np.clip(1 - np.abs(t - k), 0, 1) for k, word in enumerate(words)}


def _add(vertices: Array, region: Region, target: Target, weight: Array) -> None:
    ids, offsets = target
    local = region.index[ids]
    inside = local >= 0
    vertices[:, local[inside]] += weight[:, None, None] * offsets[inside]
