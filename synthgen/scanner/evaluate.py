"""Figures of a measurement against the truth: pairs, whole scans, and the noise that must be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.spatial import cKDTree

from synthgen.errors import ScanError
from synthgen.geometry.normals import face_cross, unit
from synthgen.scanner.dic_reference import DicSettings
from synthgen.scanner.glass import seen_position
from synthgen.scanner.result import Scan, UnitScan
from synthgen.scanner.rig import Unit
from synthgen.scanner.stage import Stage
from synthgen.scanner.truth import seen_from

Array = NDArray[np.float64]
INLIER_MM = 1.0
CORE_PX = 9
LEAST_FACING = 0.26


@dataclass(frozen=True)
class PairFigures:
    """One unit's depth errors, millimetres along its axis.

    Attributes
    ----------
    core_mm, all_mm : float
        RMS of errors below 1 mm, at least 9 pixels from edges and occlusions, and everywhere.
    outliers, complete : float
        Of the matched samples that both cameras see, the share with a larger error; matched share
        of what both cameras see. What was matched where one camera is blind counts in neither.
    bias_mm : float
        Median.
    """

    core_mm: float
    all_mm: float
    outliers: float
    complete: float
    bias_mm: float


def pair_figures(measured: UnitScan) -> PairFigures:
    """Compare a unit's disparities with the ideal ones.

    Raises
    ------
    ScanError
        If the scan was made without ``settings.true_disparity``.
    """
    if measured.true_disparity is None:
        raise ScanError(
            f"unit {measured.ident} has no true disparities to compare with; scan with "
            "settings.true_disparity = True"
        )
    found, true = (
        measured.pair.depth(d.astype(np.float64))
        for d in (measured.disparity, measured.true_disparity)
    )
    error = 1e3 * (found - true)
    both, seen = np.isfinite(error), np.isfinite(measured.true_disparity)
    n = 2 * round(CORE_PX / measured.step) + 1
    core = cv2.erode(seen.astype(np.uint8), np.ones((n, n), np.uint8)) > 0
    return PairFigures(
        core_mm=_rms(error[both & core]),
        all_mm=_rms(error[both]),
        outliers=float((np.abs(error[both]) > INLIER_MM).mean()),
        complete=float(both.sum() / seen.sum()),
        bias_mm=float(np.median(error[both])),
    )


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error[np.abs(error) < INLIER_MM] ** 2)))


def predicted_sigma(picture: NDArray[Any], noise: NDArray[Any], settings: DicSettings) -> Array:
    """Least standard error (H, W) of a disparity, pixels: the Cramer-Rao bound of its window.

    Parameters
    ----------
    picture : (H, W) float
        Without noise, as the matcher sees it.
    noise : (H, W) float
        Standard deviation of one picture's pixels.
    settings : DicSettings
        Its Gaussian weights give the sandwich form ``sqrt(sum 2 s^2 w^2 g^2) / sum w g^2``.
    """
    slope = np.gradient(np.asarray(picture, np.float64), axis=1) ** 2
    w = settings.weights
    top = _windowed(2 * np.asarray(noise, np.float64) ** 2 * slope, w**2)
    return np.asarray(np.sqrt(top) / np.maximum(_windowed(slope, w), 1e-9))


def _windowed(values: Array, weights: Array) -> Array:
    return np.asarray(correlate1d(correlate1d(values, weights, axis=0), weights, axis=1))


def seen_by_pairs(stage: Stage, units: tuple[Unit, ...], points: Array, normals: Array) -> Any:
    """Tell which surface points (n, 3) some unit sees with both cameras at a cosine above 0.26."""
    seen = np.zeros(len(points), dtype=bool)
    for unit_ in units:
        both = np.ones(len(points), dtype=bool)
        for camera in (unit_.true.left, unit_.true.right):
            eyes = seen_position(stage.rig.glass, camera.position, points)
            facing = np.einsum("nk,nk->n", unit(eyes - points), normals)
            both &= (facing > LEAST_FACING) & seen_from(stage, camera, points)
        seen |= both
    return seen


def surface_samples(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Return the faces' middles (F, 3), unit normals (F, 3) and areas (F,), to ask coverage of."""
    cross = face_cross(vertices, faces)
    return vertices[faces].mean(axis=1), unit(cross), np.linalg.norm(cross, axis=1) / 2


def coverage(
    scan: Scan, points: Array, areas: Array, seen: NDArray[np.bool_], within_m: float
) -> tuple[float, float]:
    """Return the shares of seen and of never-seen surface that the scan has within a distance.

    Parameters
    ----------
    scan : Scan
    points : (n, 3) float64
        On the true surface, without what closes it where it was cut.
    areas : (n,) float64
        What each stands for; shares of points would depend on where a mesh is fine: in folds and
        round nails, where least is seen.
    seen : (n,) bool
        See :func:`seen_by_pairs`.
    within_m : float
    """
    away = cKDTree(scan.vertices).query(points, distance_upper_bound=within_m)[0]
    near = np.asarray(away) < within_m

    def share(of: NDArray[np.bool_]) -> float:
        return float(areas[near & of].sum() / max(areas[of].sum(), 1e-12))

    return share(seen), share(~seen)
