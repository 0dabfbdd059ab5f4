"""A population of whole adults: as :mod:`synthgen.cc0.people`, both sides alike, with faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.people import Region, between, traits
from synthgen.cc0.source import CUPS, MakeHuman, Target

Array = NDArray[np.float64]
# Local morphs of the whole body by folder, and the standard deviation of their strength.
_LOCAL_SD = {
    "arms": 0.12, "legs": 0.12, "torso": 0.10, "hip": 0.12, "stomach": 0.10, "neck": 0.12,
    "feet": 0.08, "hands": 0.10, "buttocks": 0.2, "head": 0.12, "nose": 0.2, "chin": 0.15,
    "cheek": 0.2, "ears": 0.2, "mouth": 0.2, "forehead": 0.15, "eyes": 0.15, "eyebrows": 0.2,
}  # fmt: skip
_ENDS = (
    ("-decr", "-incr"), ("-down", "-up"), ("-in", "-out"), ("-backward", "-forward"),
    ("-concave", "-convex"), ("-compress", "-uncompress"),
)  # fmt: skip
# What would move parts apart, or is not a healthy adult's.
_LEFT_OUT = ("trans", "pregnant", "measure-", "nipple", "head-age")


def sample_bodies(
    source: MakeHuman, region: Region, n: int, *, rng: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """Draw n adults; return their region's vertices (n, R, 3), metres, and who is a man (n,)."""
    words = traits(n, rng)
    cup = rng.beta(4, 4, n)
    words |= between(cup, CUPS) | {"averagefirmness": np.ones(n)}
    strengths, targets = [], []
    for key, target in (source.macro_targets() | source.cup_targets()).items():
        strengths.append(np.prod([words[word] for word in key], axis=0))
        targets.append(target)
    for low, high, sigma in _local_pairs(source):
        strength = np.clip(rng.normal(0, sigma, n), -0.7, 0.7)
        for names, amount in ((low, np.maximum(-strength, 0)), (high, np.maximum(strength, 0))):
            for name in names:
                strengths.append(amount)
                targets.append(source.target(name))
    vertices = np.tile(source.vertices[region.ids].ravel(), (n, 1))
    for start in range(0, len(targets), 100):  # in parts, for memory
        part = slice(start, start + 100)
        vertices += np.stack(strengths[part], axis=1) @ _dense(targets[part], region)
    return vertices.reshape(n, -1, 3), words["male"] > 0.5


def _dense(targets: list[Target], region: Region) -> Array:
    table = np.zeros((len(targets), len(region.ids), 3))
    for row, (ids, offsets) in zip(table, targets, strict=True):
        local = region.index[ids]
        row[local[local >= 0]] = offsets[local >= 0]
    return table.reshape(len(targets), -1)


def _local_pairs(source: MakeHuman) -> list[tuple[list[str], list[str], float]]:
    """Morphs by opposite ends; left and right ones, if there are two, move together."""
    pairs = []
    for folder, sigma in _LOCAL_SD.items():
        names = set(source.target_names(folder))
        for low in sorted(names):
            ends = next(((a, b) for a, b in _ENDS if low.endswith(a)), None)
            stem = low.rpartition("/")[2]
            if ends is None or stem.startswith("l-") or any(w in stem for w in _LEFT_OUT):
                continue
            high = low.removesuffix(ends[0]) + ends[1]
            if high not in names:
                continue
            both = [[name] for name in (low, high)]
            if stem.startswith("r-"):
                both = [[name, name.replace("/r-", "/l-")] for name in (low, high)]
            pairs.append((both[0], both[1], sigma))
    return pairs
