"""Fits the noise model to what a matcher really did."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import erfc

from synthgen.errors import ShapeError
from synthgen.scanner.noise import (
    DARKEST,
    SLOPES,
    Grid,
    NoiseModel,
    edge_bin,
    slope_bin,
    smoothed,
)
from synthgen.scanner.settings import MAX_STEP

LEAST_EDGE = 32
_EDGE_BINS, _INNER, _FROM_HOLES, _LAGS, _LARGEST_PX = 6, 3, 2, 4, 2.0
# Multiples of the robust deviation beyond which errors are counted to tell wild ones.
_BEYOND = (0.6745, 1.5, 2.5, 4.0, 6.0)
# Lags, samples, at which the window's own correlation is gone.
_FAR = (8, 16, 24)
_LEAST_LONG, _CLIP = 0.03, 5.0


def fit_noise(
    pairs: Sequence[tuple[Grid, Grid]], step: int, albedo: Sequence[float] | None = None
) -> NoiseModel:
    """Fit the noise model.

    Parameters
    ----------
    pairs : sequence of (measured, ideal)
        Disparity grids (h, w), pixels, NaN where unknown.
    step : int
        Pixels between their samples.
    albedo : sequence of float, optional
        Grey reflectance 0..1 of what each pair saw; without it errors do not depend on it.

    Raises
    ------
    ShapeError
        If fewer than 1000 samples are matched, grids differ in size or are smaller than 32 x 32,
        there is not one reflectance a pair, or what was measured has no errors or nothing but
        errors.
    """
    tones = _checked(pairs, step, albedo)
    smooth = min(np.arange(0.0, 2.6, 0.25), key=lambda s: _spread(pairs, float(s)))
    residuals = [measured - smoothed(ideal, float(smooth)) for measured, ideal in pairs]
    # Near edges and holes samples are missing rather than noisy; filters remove what is left.
    inner = [
        (edge_bin(np.isfinite(ideal), _EDGE_BINS) >= _INNER)
        & (edge_bin(np.isfinite(measured), _EDGE_BINS) >= _FROM_HOLES)
        for measured, ideal in pairs
    ]
    residuals = [np.where(i, r, np.nan) for i, r in zip(inner, residuals, strict=True)]
    bins = [slope_bin(ideal, step) for _, ideal in pairs]
    even = _sigma_per_bin(residuals, bins)  # steep samples are the first to be lost on dark skin
    reference, power = _tone([r / even[b] for r, b in zip(residuals, bins, strict=True)], tones)
    strength = (tones / reference) ** -power
    residuals = [r / np.float32(k) for r, k in zip(residuals, strength, strict=True)]
    sigma = _sigma_per_bin(residuals, bins)
    share, factor, base = _wildness([r / sigma[b] for r, b in zip(residuals, bins, strict=True)])
    sigma = sigma * base
    near, long_part, far = _correlation(
        [r / sigma[b] for r, b in zip(residuals, bins, strict=True)]
    )
    edge, slope = _matched_shares(pairs, bins, strength)
    return NoiseModel(
        step=step,
        sigma_px=tuple(float(round(v, 5)) for v in sigma),
        wild_share=round(share, 4),
        wild_factor=round(factor, 2),
        correlation_px=round(near * step, 2),
        long_part=round(long_part, 3),
        long_px=round(far * step, 1),
        smooth_px=round(float(smooth) * step, 2),
        edge_share=tuple(float(round(v, 3)) for v in edge),
        slope_share=tuple(float(round(v, 3)) for v in slope),
        albedo=round(reference, 3),
        albedo_power=round(power, 3),
    )


def _checked(
    pairs: Sequence[tuple[Grid, Grid]], step: int, albedo: Sequence[float] | None
) -> NDArray[np.float64]:
    """Refuse what cannot be fitted; return the pairs' reflectance."""
    if not 1 <= step <= MAX_STEP:
        raise ShapeError(f"step = {step}; 1 to {MAX_STEP} pixels are possible")
    for k, (measured, ideal) in enumerate(pairs):
        if measured.shape != ideal.shape or ideal.ndim != 2 or min(ideal.shape) < LEAST_EDGE:
            raise ShapeError(
                f"pair {k}: grids of shapes {measured.shape} and {ideal.shape}; give two equal "
                f"(h, w) of at least {LEAST_EDGE} x {LEAST_EDGE} samples"
            )
    both = [(m - i)[np.isfinite(m) & np.isfinite(i)] for m, i in pairs]
    apart = np.concatenate([np.zeros(0, np.float32), *both])
    if len(apart) < 1000:
        raise ShapeError(
            f"{len(apart)} matched samples are too few to fit a noise model; give 1000"
        )
    typical = float(np.median(np.abs(apart)))
    if not 0 < typical < _LARGEST_PX:
        raise ShapeError(
            f"the median of |measured - ideal| is {typical:.3g} px; above 0 and below "
            f"{_LARGEST_PX:g} is possible: are these grids of the same pair"
        )
    tones = np.ones(len(pairs)) if albedo is None else np.array(albedo, np.float64)
    if tones.shape != (len(pairs),) or not ((tones >= 0) & (tones <= 1)).all():
        raise ShapeError(
            f"albedo = {tones.tolist()} for {len(pairs)} pairs; give one reflectance 0..1 a pair"
        )
    return np.maximum(tones, DARKEST)


def _tone(residuals: list[NDArray[Any]], albedo: NDArray[np.float64]) -> tuple[float, float]:
    """Reflectance in the middle, and the power of it by which the pairs' deviations fall."""
    middle = float(np.exp(np.mean(np.log(albedo))))
    if np.ptp(np.log(albedo)) < np.log(1.5):
        return middle, 0.0
    enough = np.array([np.isfinite(r).sum() > 300 for r in residuals])
    if enough.sum() < 2 or np.ptp(np.log(albedo[enough])) < np.log(1.5):
        return middle, 0.0  # no two tones to compare
    spread = [1.4826 * float(np.nanmedian(np.abs(r))) if e else 1.0
              for r, e in zip(residuals, enough, strict=True)]  # fmt: skip
    slope = np.polyfit(np.log(albedo[enough]), np.log(np.array(spread)[enough]), 1)[0]
    return middle, float(np.clip(-slope, 0, 2))


def _spread(pairs: Sequence[tuple[Grid, Grid]], sigma: float) -> float:
    """Median absolute residual, pixels, if the shape is smoothed by ``sigma`` samples."""
    each = [np.abs(measured - smoothed(ideal, sigma)).ravel() for measured, ideal in pairs]
    return float(np.nanmedian(np.concatenate(each)))


def _sigma_per_bin(residuals: list[Grid], bins: list[NDArray[np.int64]]) -> NDArray[np.float64]:
    """Robust standard deviation per bin of slope; empty bins take their neighbour's."""
    values = np.concatenate([r.ravel() for r in residuals])
    where = np.concatenate([b.ravel() for b in bins])
    sigma = np.full(len(SLOPES), np.nan)
    for k in range(len(SLOPES)):
        own = values[(where == k) & np.isfinite(values)]
        if len(own) > 30:
            sigma[k] = 1.4826 * np.median(np.abs(own))
    known = np.flatnonzero(np.isfinite(sigma))
    if not len(known):
        raise ShapeError("no bin of slope has 31 matched samples away from edges and holes")
    return np.asarray(np.interp(np.arange(len(SLOPES)), known, sigma[known]))


def _wildness(scaled: list[NDArray[Any]]) -> tuple[float, float, float]:
    """Share and scale of wilder errors, and the scale of the others, in robust deviations.

    A mixture of two normal laws that has the same shares beyond some bounds.
    """
    values = np.abs(np.concatenate([s[np.isfinite(s)] for s in scaled]))
    values = values[values < _LARGEST_PX / 0.02]
    bounds = np.array(_BEYOND)
    beyond = np.array([(values > b).mean() for b in bounds])
    if beyond[2] < 1.2 * erfc(bounds[2] / np.sqrt(2)):
        return 0.0, 1.0, 1.0

    def misfit(x: NDArray[np.float64]) -> NDArray[np.float64]:
        share, factor, base = x
        z = bounds / (base * np.sqrt(2))
        expected = (1 - share) * erfc(z) + share * erfc(z / factor)
        return np.asarray(np.log(expected + 1e-6) - np.log(beyond + 1e-6))

    found = least_squares(misfit, [0.05, 4.0, 0.9], bounds=([0, 1, 0.5], [0.5, 20, 1.0]))
    share, factor, base = (float(v) for v in found.x)
    return share, factor, base


def _correlation(scaled: list[NDArray[Any]]) -> tuple[float, float, float]:
    """Sigma, samples, of the smoothing behind the residuals' autocorrelation, and its long part.

    White noise under a Gaussian of sigma s has the autocorrelation exp(-lag^2 / (4 s^2)). What is
    left where a window's errors have nothing in common any more is the long part: its standard
    deviation, and its own sigma.
    """
    clipped = [np.clip(s, -_CLIP, _CLIP) for s in scaled]
    zero = _at_lag(clipped, 0)
    far = [max(_at_lag(clipped, lag) / zero, 0.0) for lag in _FAR]
    share = far[0] if far[0] > _LEAST_LONG else 0.0
    fall = np.log(max(far[0], 1e-3) / max(far[-1], 1e-3))
    reach = float(np.sqrt((_FAR[-1] ** 2 - _FAR[0] ** 2) / (4 * max(fall, 0.05))))
    found = []
    for lag in range(1, _LAGS + 1):
        near = (_at_lag(clipped, lag) / zero - share) / (1 - share)
        if near < 0.1:
            break
        found.append(lag / np.sqrt(-4 * np.log(min(near, 0.999))))
    return float(np.mean(found)) if found else 0.0, min(float(np.sqrt(share * zero)), 0.9), reach


def _at_lag(clipped: list[NDArray[Any]], lag: int) -> float:
    """Mean product of samples that lie ``lag`` apart, across and down."""
    across = [(c[:, lag:] * c[:, : c.shape[1] - lag]).ravel() for c in clipped]
    down = [(c[lag:] * c[: len(c) - lag]).ravel() for c in clipped]
    return float(np.nanmean(np.concatenate(across + down)))


def _matched_shares(
    pairs: Sequence[tuple[Grid, Grid]],
    bins: list[NDArray[np.int64]],
    strength: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Share of samples that were matched, by distance from edges, and by slope away from them.

    What was lost is counted as on a surface of strength 1.
    """
    known = np.concatenate([np.isfinite(ideal).ravel() for _, ideal in pairs])
    matched = np.concatenate([
        1 - ~np.isfinite(measured).ravel() / k**2
        for (measured, _), k in zip(pairs, strength, strict=True)
    ])[known]  # fmt: skip
    edges = [edge_bin(np.isfinite(ideal), _EDGE_BINS).ravel() for _, ideal in pairs]
    edge = np.concatenate(edges)[known]
    slope = np.concatenate([b.ravel() for b in bins])[known]
    inner = edge == _EDGE_BINS - 1
    by_slope = np.clip([_share(matched, inner & (slope == k)) for k in range(len(SLOPES))], 0, 1)
    expected = by_slope[slope]  # edges are steep: what the slope explains is not the edge's
    by_edge = np.array(
        [matched[edge == k].sum() / max(expected[edge == k].sum(), 1e-6) for k in range(_EDGE_BINS)]
    )
    return np.clip(by_edge, 0, 1), by_slope


def _share(matched: NDArray[np.float64], where: NDArray[np.bool_]) -> float:
    return float(matched[where].mean()) if where.any() else 0.0
