"""Fits the noise model to what a matcher really did."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.scanner.noise import (
    LAWS,
    LEAST_MATT,
    RINGS,
    SCORES,
    SHARES,
    SLOPES,
    Grid,
    NoiseModel,
    beyond_share,
    continued,
    edge_bin,
    laws,
    slope_bin,
    smoothed,
)
from synthgen.scanner.settings import MAX_STEP

LEAST_EDGE = 32
_EDGE_BINS, _LAGS, _LARGEST_PX, _FAULTY_PX = 6, 4, 2.0, 20.0
# A law that fewer samples speak for is that of its neighbour; a pair with fewer has no scale.
_LEAST, _LEAST_OF_PAIR = 200, 300
# Lags, samples, at which the window's own correlation is gone.
_FAR = (8, 16, 24)
_LEAST_LONG, _MOST_LONG = 0.03, 0.8


def fit_noise(
    pairs: Sequence[tuple[Grid, Grid]], step: int, matt: Sequence[float] | None = None
) -> NoiseModel:
    """Fit the noise model.

    Parameters
    ----------
    pairs : sequence of (measured, ideal)
        Disparity grids (h, w), pixels, NaN where unknown.
    step : int
        Pixels between their samples.
    matt : sequence of float, optional
        Mattness 0..1 of what each pair saw, see :func:`synthgen.scanner.noise.mattness`; without it
        errors do not depend on it.

    Raises
    ------
    ShapeError
        If fewer than 1000 samples are matched, grids differ in size or are smaller than 32 x 32,
        there is not one mattness a pair, or what was measured has no errors or nothing but
        errors.
    """
    tones = _checked(pairs, step, matt)
    smooth = min(np.arange(0.0, 2.6, 0.25), key=lambda s: _spread(pairs, float(s)))
    residuals = [m - continued(smoothed(i, float(smooth))) for m, i in pairs]
    law = [laws(ideal, step) for _, ideal in pairs]
    scale = _scales(residuals, law)
    reference, power, spread = _tone(scale, tones)
    strength = (tones / reference) ** -power
    errors = _laws([r / np.float32(s) for r, s in zip(residuals, scale, strict=True)], law)
    near, long_part, far = _correlation(_scores(residuals, scale, law, errors))
    edge, slope = _matched_shares(pairs, [slope_bin(i, step) for _, i in pairs], strength)
    beyond = np.sum([beyond_share(measured, ideal) for measured, ideal in pairs], axis=0)
    return NoiseModel(
        step=step,
        errors_px=tuple(_rounded(quantiles, 4) for quantiles in errors),
        correlation_px=round(near * step, 2),
        long_part=round(long_part, 3),
        long_px=round(float(np.clip(far * step, 1, 500)), 1),
        smooth_px=round(float(smooth) * step, 2),
        edge_share=_rounded(edge, 3),
        slope_share=_rounded(slope, 3),
        fringe_share=_rounded(beyond[0] / np.maximum(beyond[1], 1), 3),
        matt=round(reference, 5),
        matt_power=round(power, 3),
        pair_spread=round(spread, 3),
    )


def _rounded(values: NDArray[np.float64], digits: int) -> tuple[float, ...]:
    return tuple(round(float(value), digits) for value in values)


def _checked(
    pairs: Sequence[tuple[Grid, Grid]], step: int, matt: Sequence[float] | None
) -> NDArray[np.float64]:
    """Refuse what cannot be fitted; return the pairs' mattness."""
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
    tones = np.ones(len(pairs)) if matt is None else np.array(matt, np.float64)
    if tones.shape != (len(pairs),) or not ((tones >= 0) & (tones <= 1)).all():
        raise ShapeError(
            f"matt = {tones.tolist()} for {len(pairs)} pairs; give one mattness 0..1 a pair"
        )
    return np.maximum(tones, LEAST_MATT)


def _spread(pairs: Sequence[tuple[Grid, Grid]], sigma: float) -> float:
    """Median absolute residual, pixels, if the shape is smoothed by ``sigma`` samples."""
    each = [np.abs(measured - smoothed(ideal, sigma)).ravel() for measured, ideal in pairs]
    return float(np.nanmedian(np.concatenate(each)))


def _inner(residual: Grid, law: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Known residuals away from edges."""
    return np.isfinite(residual) & (law >= RINGS) & (law < LAWS - 1)


def _deviation(values: NDArray[Any]) -> float:
    return 1.4826 * float(np.median(np.abs(values)))


def _scales(residuals: list[Grid], law: list[NDArray[np.int64]]) -> NDArray[np.float64]:
    """How large each pair's errors are (n,), away from edges, against all pairs' of equal slope.

    Their geometric mean is 1; so is that of a pair that matched next to nothing.
    """
    pooled, inner = np.ones(LAWS), [_inner(r, b) for r, b in zip(residuals, law, strict=True)]
    for k in range(RINGS, LAWS - 1):
        own = [r[i & (b == k)] for r, i, b in zip(residuals, inner, law, strict=True)]
        values = np.concatenate(own)
        pooled[k] = _deviation(values) if len(values) > _LEAST else np.nan
    pooled = np.where(np.isfinite(pooled), pooled, np.nanmean(pooled[RINGS:-1]))
    size = np.array([
        np.log(_deviation((r / pooled[b])[i])) if i.sum() > _LEAST_OF_PAIR else np.nan
        for r, i, b in zip(residuals, inner, law, strict=True)
    ])  # fmt: skip
    if not np.isfinite(size).any():
        raise ShapeError(
            f"no pair has {_LEAST_OF_PAIR} matched samples that are {RINGS} or more from an edge"
        )
    return np.exp(np.where(np.isfinite(size), size - np.nanmean(size), 0.0))


def _tone(scale: NDArray[np.float64], matt: NDArray[np.float64]) -> tuple[float, float, float]:
    """Mattness in the middle, the power of it by which errors fall, and what pairs differ by."""
    middle, size = float(np.exp(np.mean(np.log(matt)))), np.log(scale)
    if np.ptp(np.log(matt)) < np.log(1.5):  # no two tones to compare
        return middle, 0.0, min(float(np.std(size)), 1.0)
    slope = np.polyfit(np.log(matt), size, 1)[0]
    power = float(np.clip(-slope, 0, 2))
    rest = size + power * np.log(matt / middle)
    return middle, power, min(float(np.std(rest)), 1.0)


def _laws(residuals: list[Grid], law: list[NDArray[np.int64]]) -> NDArray[np.float64]:
    """Quantiles (LAWS, n) of the residuals; a law with too few samples is like one further in."""
    values = np.concatenate([r.ravel() for r in residuals])
    where = np.concatenate([b.ravel() for b in law])
    values, where = (v[np.isfinite(values)] for v in (values, where))
    found = np.full((LAWS, len(SHARES)), np.nan)
    for k in range(LAWS):
        own = values[where == k]
        if len(own) > _LEAST:
            found[k] = np.clip(np.quantile(own, SHARES), -_FAULTY_PX, _FAULTY_PX)
    known = np.flatnonzero(np.isfinite(found[:, 0]))
    inner = known[(known >= RINGS) & (known < LAWS - 1)]
    for k in range(LAWS):
        if k not in known:  # a slope takes the nearest slope's, a ring or fringe one of a ring
            among = inner if RINGS <= k < LAWS - 1 else known[known < LAWS - 1]
            found[k] = found[among[np.argmin(np.abs(among - (0 if k == LAWS - 1 else k)))]]
    return found


def _scores(
    residuals: list[Grid],
    scale: NDArray[np.float64],
    law: list[NDArray[np.int64]],
    errors: NDArray[np.float64],
) -> list[NDArray[np.float64]]:
    """Return normal scores (h, w) of residuals away from edges under their laws; else NaN."""
    found = []
    for residual, size, number in zip(residuals, scale, law, strict=True):
        score = np.full(residual.shape, np.nan)
        inner = _inner(residual, number)
        for k in range(RINGS, LAWS - 1):
            own = inner & (number == k)
            score[own] = np.interp(residual[own] / size, errors[k], SCORES)
        found.append(score)
    return found


def _correlation(scores: list[NDArray[Any]]) -> tuple[float, float, float]:
    """Sigma, samples, of the smoothing behind the scores' autocorrelation, and its long part.

    White noise under a Gaussian of sigma s has the autocorrelation exp(-lag^2 / (4 s^2)). What is
    left where a window's errors have nothing in common any more is the long part: its standard
    deviation, and its own sigma.
    """
    zero = _at_lag(scores, 0)
    far = [max(_at_lag(scores, lag) / zero, 0.0) for lag in _FAR]
    fall = np.log(max(far[0], 1e-3) / max(far[-1], 1e-3))
    reach = float(np.sqrt((_FAR[-1] ** 2 - _FAR[0] ** 2) / (4 * max(fall, 0.05))))
    whole = far[0] * np.exp((_FAR[0] / reach) ** 2 / 4)  # at no lag
    share = float(min(whole, _MOST_LONG)) if far[0] > _LEAST_LONG else 0.0
    found = []
    for lag in range(1, _LAGS + 1):
        long = share * np.exp(-((lag / reach) ** 2) / 4)
        near = (_at_lag(scores, lag) / zero - long) / (1 - share)
        if near < 0.1:
            break
        found.append(lag / np.sqrt(-4 * np.log(min(near, 0.999))))
    return float(np.mean(found)) if found else 0.0, float(np.sqrt(share)), reach


def _at_lag(scores: list[NDArray[Any]], lag: int) -> float:
    """Mean product of samples that lie ``lag`` apart, across and down; 0 where there are none."""
    across = [(c[:, lag:] * c[:, : c.shape[1] - lag]).ravel() for c in scores]
    down = [(c[lag:] * c[: len(c) - lag]).ravel() for c in scores]
    products = np.concatenate(across + down)
    known = products[np.isfinite(products)]
    return float(known.mean()) if len(known) else 0.0


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
