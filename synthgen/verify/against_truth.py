"""Whether the stored points contradict the truth, whatever a fit of them says."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.sample import Subject
from synthgen.registration import Fit
from synthgen.registration.correspondences import SMOOTH, closest
from synthgen.registration.statistics import LEAST_POINTS, PARTS, part_of_vertex
from synthgen.registration.surface import surface_of
from synthgen.verify.stored_points import StoredPoints

Array = NDArray[np.float64]
CURVED = SMOOTH  # what is drawn is smooth through the model's vertices
TRUTH_EXPLAINS = 0.97
AS_WELL, AS_WELL_M = 1.2, 5e-5
# Of sound samples 0.99 of all points and 0.94 of every part's are explained, scanner's and
# sensor's included; of a finger bent by 14 degrees at most 0.77. Of depth cameras' scans, whose
# points lie a millimetre off, as much of those that are to be trusted, but 0.56-0.77 of all.
EXPLAINED_M, FACING, PART_EXPLAINS = 1.5e-3, -0.3, 0.85


def truth_fits_as_well(subject: Subject, stored: StoredPoints, found: Fit) -> bool:
    """Tell whether the truth explains the points as a fit does, which then found another optimum.

    By the median, 95 and 99 % quantiles of the distances, the truth's without a sensor's error.
    """
    surface = surface_of(subject.loaded)
    true = _distances(surface.pack(subject.shape, subject.pose, subject.translation), subject,
                      stored.exact, stored.normals)  # fmt: skip
    own = surface_of(subject.loaded).pack(found.shape, found.pose, found.translation)
    fitted = _distances(own, subject, stored.points, stored.normals)
    return bool(np.isfinite(true).all() and np.all(true <= AS_WELL * fitted + AS_WELL_M))


def _distances(x: Array, subject: Subject, points: Array, normals: Array) -> Array:
    placed = surface_of(subject.loaded).at(x)
    pairs = closest(placed, points, normals, cut_m=0.05, cosine=-2.0, curved=CURVED)
    squared = pairs.squared[~pairs.rim]
    if len(squared) == 0:  # all beyond the wrist's rim: elsewhere
        return np.full(3, np.inf)
    return np.asarray(np.quantile(np.sqrt(squared), [0.5, 0.95, 0.99]))


def truth_explained(subject: Subject, stored: StoredPoints) -> tuple[float, dict[str, float]]:
    """Share of the points, less the sensor's error, within 1.5 mm of the true surface; and by part.

    Of the trusted points within 3 cm, since scans have clutter; 0 if the cloud is elsewhere.
    Normals must not face the other way: across the creases of small pictures they are rough. Parts
    near which fewer than 60 points lie are left out, and fewer say nothing of the whole.
    """
    if len(stored.points) == 0:
        return 0.0, {}
    surface = surface_of(subject.loaded)
    placed = surface.at(surface.pack(subject.shape, subject.pose, subject.translation))
    pairs = closest(placed, stored.exact, stored.normals, cut_m=0.03, cosine=-2.0, curved=CURVED)
    alike = np.sum(pairs.normal * stored.normals, axis=1) > FACING
    good = (pairs.squared < EXPLAINED_M**2) & alike
    far = np.linalg.norm(stored.exact.mean(axis=0) - placed.vertices.mean(axis=0)) > 0.15
    if far or not pairs.kept.any():
        return 0.0, {}
    used = pairs.kept & stored.trusted
    if used.sum() < LEAST_POINTS <= pairs.kept.sum():
        return 1.0, {}
    part = np.where(used, part_of_vertex(placed.surface.model)[pairs.corner], -1)
    by_part = {name: float(good[part == k].mean()) for k, name in enumerate(PARTS)
               if np.sum(part == k) >= LEAST_POINTS}  # fmt: skip
    return float(good[used].mean()) if used.any() else 1.0, by_part


def contradiction(explained: float, by_part: dict[str, float]) -> str:
    """Say where the stored points contradict the truth, "" where they do not."""
    if explained < TRUTH_EXPLAINS:
        return f"only {100 * explained:.0f} % of the stored points lie on the true surface"
    worst = min(by_part, key=lambda name: by_part[name], default="")
    if worst and by_part[worst] < PART_EXPLAINS:
        share = 100 * by_part[worst]
        return f"only {share:.0f} % of the points at the {worst} lie on the true surface"
    return ""
