"""What calibration and motion alone do to a fused scan: points and cameras, no pictures.

Surface points are seen by the true cameras and read with the nominal calibration; what several
units see is averaged with the weights of fusion. Thousands of points cost milliseconds, so that
hundreds of scanners can be drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.scanner_parts import setting
from synthgen.geometry.cameras import project
from synthgen.geometry.normals import unit
from synthgen.scanner.evaluate import seen_by_pairs
from synthgen.scanner.load import build_rig, list_rigs, read_spec
from synthgen.scanner.rectify import rectified_pixels, rectify
from synthgen.scanner.rig import Rig, Unit

EVERY = 40


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points (n, 3) of a surface, unit normals (n, 3), and which unit sees them, (units, n)."""

    points: Any
    normals: Any
    seen: Any


def seen_points(solid: Any) -> SeenPoints:
    """Take every fortieth vertex of a solid, and look where it is seen from."""
    of = setting.rig()
    stage = setting.staged([solid], of)
    points, normals = solid.vertices[::EVERY], solid.normals[::EVERY]
    seen = [seen_by_pairs(stage, (u,), points, normals) for u in of.units]
    return SeenPoints(points, normals, np.array(seen))


def with_errors(seed: int, **errors: float) -> Rig:
    """Draw hand5 with only the calibration errors that are named."""
    path = list_rigs()["hand5"]
    spec = read_spec(path)
    none = dict.fromkeys(
        ("focal", "principal_px", "rotation_rad", "translation_m", "k1", "unit_rotation_rad",
         "unit_translation_m"), 0.0,
    )  # fmt: skip
    error = spec.error.model_copy(update=none | errors)
    return build_rig("hand5", spec.model_copy(update={"error": error}), seed, path.parent)


def fused_error_mm(of: Rig, at: SeenPoints, moved_m: Any = None) -> float:
    """RMS over the points of the error along the normal; ``moved_m`` (units, 3) per unit."""
    total, weight = np.zeros(len(at.points)), np.zeros(len(at.points))
    for k, unit_ in enumerate(of.units):
        mask = at.seen[k]
        shift = np.zeros(3) if moved_m is None else moved_m[k]
        normals, points = at.normals[mask], at.points[mask]
        error = np.einsum("nk,nk->n", _read(unit_, points + shift) - points, normals)
        eye = unit_.nominal.left.position
        away = np.linalg.norm(eye - points, axis=1)
        share = np.einsum("nk,nk->n", unit(eye - points), normals) / away**2
        total[mask] += share * error
        weight[mask] += share
    there = weight > 0
    return 1e3 * float(np.sqrt(np.mean((total[there] / weight[there]) ** 2)))


def _read(unit_: Unit, points: Any) -> Any:
    """Where a unit puts points (n, 3): true cameras, perfect matching, nominal calibration."""
    pair = rectify(unit_.nominal.left, unit_.nominal.right)
    cameras = unit_.true.left, unit_.true.right
    left, right = (rectified_pixels(pair, k, project(c, points)[0]) for k, c in enumerate(cameras))
    return pair.points(left[:, 0], left[:, 1], left[:, 0] - right[:, 0])
