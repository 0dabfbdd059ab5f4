"""Fits the noise model to what a matcher really did."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.scanner.noise import SLOPES, Grid, NoiseModel, edge_bin, slope_bin, smoothed

_EDGE_BINS, _INNER, _LAGS, _LARGEST_PX, _WILD = 6, 3, 6, 2.0, 2.5


def fit_noise(pairs: Sequence[tuple[Grid, Grid]], step: int) -> NoiseModel:
    """Fit the noise model.

    Parameters
    ----------
    pairs : sequence of (measured, ideal)
        Disparity grids (h, w), pixels, NaN where unknown.
    step : int
        Pixels between their samples.

    Raises
    ------
    ShapeError
        If fewer than 1000 samples are matched.
    """
    count = sum(int((np.isfinite(m) & np.isfinite(i)).sum()) for m, i in pairs)
    if count < 1000:
        raise ShapeError(f"{count} matched samples are too few to fit a noise model; give 1000")
    smooth = min(np.arange(0.0, 2.6, 0.25), key=lambda s: _spread(pairs, float(s)))
    residuals = [measured - smoothed(ideal, float(smooth)) for measured, ideal in pairs]
    # Near edges samples are missing rather than noisy, and filters remove what is left.
    inner = [edge_bin(np.isfinite(ideal), _EDGE_BINS) >= _INNER for _, ideal in pairs]
    residuals = [np.where(i, r, np.nan) for i, r in zip(inner, residuals, strict=True)]
    bins = [slope_bin(ideal, step) for _, ideal in pairs]
    sigma = _sigma_per_bin(residuals, bins)
    scaled = [r / sigma[b] for r, b in zip(residuals, bins, strict=True)]
    share, factor = _wildness(scaled)
    edge, slope = _matched_shares(pairs, bins)
    return NoiseModel(
        step=step,
        sigma_px=tuple(float(round(v, 5)) for v in sigma),
        wild_share=round(share, 4),
        wild_factor=round(factor, 2),
        correlation_px=round(_correlation(scaled) * step, 2),
        smooth_px=round(float(smooth) * step, 2),
        edge_share=tuple(float(round(v, 3)) for v in edge),
        slope_share=tuple(float(round(v, 3)) for v in slope),
    )


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
    return np.asarray(np.interp(np.arange(len(SLOPES)), known, sigma[known]))


def _wildness(scaled: list[NDArray[Any]]) -> tuple[float, float]:
    """Share of samples beyond 2.5 sigma that a normal law does not explain, and their scale."""
    values = np.abs(np.concatenate([s[np.isfinite(s)] for s in scaled]))
    values = values[values < _LARGEST_PX / 0.02]
    beyond = values[values > _WILD]
    share = max(len(beyond) / len(values) - 0.0124, 0.0)
    if share == 0.0:
        return 0.0, 1.0
    factor = float(np.sqrt(np.mean(np.clip(beyond, 0, 20) ** 2)) / 1.5)
    return share, max(factor, 1.0)


def _correlation(scaled: list[NDArray[Any]]) -> float:
    """Sigma, samples, of the smoothing that gives the residuals' autocorrelation.

    White noise under a Gaussian of sigma s has the autocorrelation exp(-lag^2 / (4 s^2)).
    """
    clipped = [np.clip(s, -3, 3) for s in scaled]
    zero = np.nanmean(np.concatenate([c.ravel() for c in clipped]) ** 2)
    found = []
    for lag in range(1, _LAGS):
        across = [c[:, lag:] * c[:, :-lag] for c in clipped]
        down = [c[lag:] * c[:-lag] for c in clipped]
        mean = np.nanmean(np.concatenate([p.ravel() for p in across + down])) / zero
        if mean < 0.1:
            break
        found.append(lag / np.sqrt(-4 * np.log(min(mean, 0.999))))
    return float(np.mean(found)) if found else 0.0


def _matched_shares(
    pairs: Sequence[tuple[Grid, Grid]], bins: list[NDArray[np.int64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Share of samples that were matched, by distance from edges, and by slope away from them."""
    known = np.concatenate([np.isfinite(ideal).ravel() for _, ideal in pairs])
    matched = np.concatenate([np.isfinite(measured).ravel() for measured, _ in pairs])[known]
    edges = [edge_bin(np.isfinite(ideal), _EDGE_BINS).ravel() for _, ideal in pairs]
    edge = np.concatenate(edges)[known]
    slope = np.concatenate([b.ravel() for b in bins])[known]
    inner = edge == _EDGE_BINS - 1
    by_slope = np.array([_share(matched, inner & (slope == k)) for k in range(len(SLOPES))])
    expected = by_slope[slope]  # edges are steep: what the slope explains is not the edge's
    by_edge = np.array(
        [matched[edge == k].sum() / max(expected[edge == k].sum(), 1e-6) for k in range(_EDGE_BINS)]
    )
    return np.clip(by_edge, 0, 1), by_slope


def _share(matched: NDArray[np.bool_], where: NDArray[np.bool_]) -> float:
    return float(matched[where].mean()) if where.any() else 0.0
