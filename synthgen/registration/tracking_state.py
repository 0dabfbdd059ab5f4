"""What a tracked frame says about itself, cheaply: every part of the body against the scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import face_cross
from synthgen.models.joints import SIDES
from synthgen.registration.body_schedule import hand_crops, hand_vertices
from synthgen.registration.body_statistics import (
    EXPLAINED,
    FAR,
    LEAST_POINTS,
    PARTS,
    UNEXPLAINED,
    part_of_vertex,
)
from synthgen.registration.body_surface import BodyPlaced, BodySurface
from synthgen.registration.correspondences import closest
from synthgen.registration.scan import Scan
from synthgen.registration.tracked import Unseen
from synthgen.registration.verdict import Judgement

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
# Points farther than the first are not the body's; those within the second are explained.
NEAR_M, LIMIT_M, FACING = 0.05, 3e-3, 0.2
LOOKED, LOOKED_HAND = 3000, 1000
# A hand of which more is unexplained is missed; it must improve by so much to be replaced.
MISSED, GAIN = 0.15, 0.03
# A part of few points is missed where its share is so many standard errors above the limit.
ERRORS = 2.0
# A part with less than this share of the points that its skin should have is not seen.
SEEN = 0.15
# With more such parts than legs and feet there is no body to go on from.
MOST_HIDDEN = 4


@dataclass(frozen=True, eq=False)
class BodyState:
    """A placed body against a scan.

    Attributes
    ----------
    present : dict of side to float
        Points of each hand over points expected.
    points : (10,) int
        Looked at, by part.
    unexplained : (10,)
        By part, share of points off the skin by 3 mm or facing away; NaN where there are few.
    explained, far : float
        Of all points: share of those within 50 mm that are explained; share of those beyond.
    noise_m : float
        Standard deviation of the points about the skin.
    hidden : tuple of str
        Parts other than hands that have hardly a point.
    """

    present: dict[str, float]
    points: NDArray[np.int64]
    unexplained: Array
    explained: float
    far: float
    noise_m: float
    hidden: tuple[str, ...] = ()

    @classmethod
    def of(cls, placed: BodyPlaced, scan: Scan) -> BodyState:
        """Compare."""
        crops = hand_crops(placed, scan)
        some = np.arange(min(LOOKED, len(scan.points)))
        ids = np.concatenate([some, *(c[:LOOKED_HAND] for c in crops)])
        pairs = closest(placed, scan.points[ids], scan.normals[ids], cut_m=NEAR_M, cosine=-2.0)
        distance, near = np.sqrt(pairs.squared), pairs.kept
        facing = np.sum(pairs.normal * scan.normals[ids], axis=1) > FACING
        bad = (distance > LIMIT_M) | ~facing
        corner = pairs.triangle[np.arange(len(ids)), pairs.barycentric.argmax(axis=1)]
        part = part_of_vertex(placed.surface.model)[corner]
        unexplained = np.full(len(PARTS), np.nan)
        for k in range(len(PARTS)):
            own = near & (part == k)
            if own.sum() >= LEAST_POINTS:
                unexplained[k] = bad[own].mean()
        plain = near[: len(some)]
        found = np.bincount(part[: len(some)][plain], minlength=len(PARTS))
        bare = found < SEEN * len(some) * part_shares(placed.surface)
        close = distance[: len(some)][plain]
        return cls(
            present=presence(placed, scan, crops),
            points=np.bincount(part[near], minlength=len(PARTS)),
            unexplained=unexplained,
            explained=float((~bad)[: len(some)][plain].mean()) if plain.any() else 0.0,
            far=float((~plain).mean()),
            noise_m=float(np.median(close)) / 0.6745 if plain.any() else NEAR_M,
            hidden=tuple(p for p, b in zip(PARTS, bare, strict=True) if b and "hand" not in p),
        )

    def missed(self, sides: Sequence[str]) -> tuple[str, ...]:
        """Return the sides whose hands fit badly."""
        return tuple(s for s in sides if self._hand(s) > MISSED)

    def better(self, other: BodyState, sides: Sequence[str]) -> tuple[str, ...]:
        """Return the sides whose hands this state explains clearly better than another."""
        return tuple(s for s in sides if self._hand(s) < other._hand(s) - GAIN)

    def _hand(self, side: str) -> float:
        return float(self.unexplained[PARTS.index(f"{side}_hand")])

    def judged(self, unseen: Unseen) -> Judgement:
        """Judge a frame; hands that are not seen are no failure."""
        if self.far > FAR:
            return Judgement("fail", "background")
        if self.explained < EXPLAINED:
            return Judgement("fail", "not_converged")
        gone = tuple(f"{side}_hand" for side in SIDES if unseen[side])
        limit = np.array([MISSED if "hand" in part else UNEXPLAINED for part in PARTS])
        limit += ERRORS * np.sqrt(limit * (1 - limit) / np.maximum(self.points, 1))
        bad = tuple(part for part, off in zip(PARTS, self.unexplained > limit, strict=True)
                    if off and part not in gone)  # fmt: skip
        if bad:
            return Judgement("fail", "part_missed", bad)
        if len(self.hidden) > MOST_HIDDEN:
            return Judgement("fail", "part_missed", self.hidden)
        gone = tuple(part for part in PARTS if part in gone + self.hidden)
        return Judgement("unobserved", "hole", gone) if gone else Judgement("pass")

    def to_json(self) -> dict[str, Any]:
        """Return JSON types."""
        shares = {part: None if np.isnan(u) else float(u)
                  for part, u in zip(PARTS, self.unexplained, strict=True)}  # fmt: skip
        return {
            "explained": self.explained,
            "far_share": self.far,
            "noise_mm": 1e3 * self.noise_m,
            "unexplained": shares,
            "present": {f"{side}_hand": share for side, share in self.present.items()},
        }


def presence(placed: BodyPlaced, scan: Scan, crops: tuple[Ids, Ids]) -> dict[str, float]:
    """Points nearest to each hand's skin over points expected."""
    shares, result = hand_shares(placed.surface), {}
    for side, crop in zip(SIDES, crops, strict=True):
        near = np.asarray(placed.tree.query(scan.points[crop])[1])
        found = np.isin(near, hand_vertices(placed.surface, side)).sum()
        result[side] = float(found / (shares[side] * len(scan.points)))
    return result


@lru_cache(maxsize=8)
def part_shares(surface: BodySurface) -> Array:
    """Share (10,) of the skin's area that each part is."""
    area = np.linalg.norm(face_cross(surface.model.v_template, surface.faces), axis=1)
    part = part_of_vertex(surface.model)[surface.faces[:, 0]]
    return np.asarray(np.bincount(part, area, len(PARTS)) / area.sum())


@lru_cache(maxsize=8)
def hand_shares(surface: BodySurface) -> dict[str, float]:
    """Share of the skin's area that each hand is."""
    area = np.linalg.norm(face_cross(surface.model.v_template, surface.faces), axis=1)
    shares = {}
    for side in SIDES:
        own = np.zeros(surface.n_vertices, dtype=bool)
        own[hand_vertices(surface, side)] = True
        shares[side] = float(area[own[surface.faces[:, 0]]].sum() / area.sum())
    return shares
