"""The scanner's noise without its pictures: a model of matching errors, fitted to measured ones.

Residuals of a matcher (measured minus ideal disparity) are no white noise: within a window they
are one error, in the rings at an edge they are large and one-sided, with slant they change, their
tails are heavy, and on dark or oily skin, where gloss has more of the light, all gets worse. The
model has just these: for every ring at an edge and for every slope beyond, the law of the errors as
its quantiles; which of them a sample gets is told by white noise that is smoothed to the window's
scale, a part of it to a longer one. Further the smoothing of the shape itself, the chance that a
sample is matched at all by its distance from the nearest edge and by its slope, what is matched
beyond the edge, a power of how matt the surface is, and the spread of units, each of which sees
gloss elsewhere.
``benchmarks/scanner_noise.py`` fits it; the results are ``scenes/noise/*.yaml``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError
from scipy.ndimage import distance_transform_edt
from scipy.special import ndtri

from synthgen.config import data_folder
from synthgen.config.explain import explain
from synthgen.config.reading import read_yaml
from synthgen.config.sections import Section
from synthgen.errors import ConfigError, ShapeError, nearest
from synthgen.scanner.match import DisparityGrid
from synthgen.scanner.subject import Solid, Surface

Grid = NDArray[np.float32]
SLOPES = (0.1, 0.2, 0.3, 0.45, 0.7)
"""Upper ends of the bins of slope (pixels of disparity per pixel); the last bin is open."""

SHARES = (0.001, 0.01, 0.03, 0.1, 0.25, 0.5, 0.75, 0.9, 0.97, 0.99, 0.999)
"""Shares of errors that lie below the quantiles of a law."""

RINGS, FRINGE = 4, 4
"""Rings of samples inside of an edge that have laws of their own, and rings outside of it in which
there may still be something matched."""

LAWS = RINGS + len(SLOPES) + 1
"""Laws of errors: rings from the edge inwards, then slopes, then what is matched beyond the edge,
against the nearest sample within."""

SCORES = ndtri(np.array(SHARES))
"""The quantiles of the normal law at these levels."""

LEAST_MATT = 1e-4
# Holes hang together over this many times the way of the errors.
_HOLES = 2
_Positive = Annotated[float, Field(ge=0.0, le=20.0)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_Error = Annotated[float, Field(ge=-200.0, le=200.0)]
_Law = Annotated[tuple[_Error, ...], Field(min_length=len(SHARES), max_length=len(SHARES))]


class NoiseModel(Section):
    """Matching errors of one scanner, in pixels of its rectified pictures."""

    step: int = Field(ge=1, le=16)
    """Pixels between the samples that it was fitted on."""

    errors_px: tuple[_Law, ...] = Field(min_length=LAWS, max_length=LAWS)
    """Quantiles of the errors of the disparity, at fixed levels, by law."""

    correlation_px: _Positive
    """Standard deviation of the Gaussian that white noise is smoothed with."""

    long_part: _Share = 0.0
    """Standard deviation of what hangs together over a longer way, in that of all."""

    long_px: float = Field(default=60.0, ge=1.0, le=500.0)
    """Standard deviation of the Gaussian of that part."""

    smooth_px: _Positive
    """Standard deviation of the Gaussian that the shape is smoothed with."""

    edge_share: tuple[_Share, ...] = Field(min_length=1)
    """Share of samples matched at 1, 2, 3, ... samples from the nearest edge; the last holds on."""

    slope_share: tuple[_Share, ...] = Field(min_length=len(SLOPES), max_length=len(SLOPES))
    """Share of samples matched per bin of slope, away from edges."""

    fringe_share: tuple[_Share, ...] = Field(
        default=(0.0,) * FRINGE, min_length=FRINGE, max_length=FRINGE
    )
    """Share of samples matched 1, 2, ... samples beyond an edge."""

    matt: float = Field(default=0.02, gt=0.0, le=1.0)
    """How matt the surface is for which all this holds; see :func:`mattness`."""

    matt_power: float = Field(default=0.0, ge=0.0, le=2.0)
    """Errors grow as mattness to minus this, the share that is not matched as its square."""

    pair_spread: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation over pairs of the logarithm of how large the errors are."""

    def strength(self, matt: float) -> float:
        """Return how many times larger the errors are on a surface of some mattness."""
        return float((max(matt, LEAST_MATT) / self.matt) ** -self.matt_power)


def mattness(surface: Surface) -> float:
    """Return the diffuse light of a surface against its gloss at its brightest, up to a factor.

    The peak of a GGX lobe goes as roughness to minus four.
    """
    gloss = surface.specular / max(surface.roughness, 0.05) ** 4
    return float(np.clip(surface.albedo / max(gloss, 1e-6), LEAST_MATT, 1.0))


def strength_on(solids: Sequence[Solid], model: NoiseModel) -> float:
    """Return the strength of errors on the first subject of a scene, or its first solid."""
    seen = next((solid for solid in solids if solid.kind == "subject"), solids[0])
    return model.strength(mattness(seen.surface))


def load_noise(name: str) -> NoiseModel:
    """Load ``scenes/noise/NAME.yaml``.

    Raises
    ------
    ConfigError
        If there is none, or it is wrong.
    """
    known: dict[str, Path] = {
        path.stem: path for path in sorted((data_folder("scenes") / "noise").glob("*.yaml"))
    }
    if name not in known:
        raise ConfigError(
            f"no noise model {name!r}{nearest(name, known)}; there are {', '.join(known)}. Fit one "
            "with benchmarks/scanner_noise.py, or use level full or half"
        )
    document = read_yaml(known[name])
    origins = {"": str(known[name])}
    origins |= {key: f"{known[name]}, line {line}" for key, line in document.lines.items()}
    try:
        return NoiseModel.model_validate_json(json.dumps(document.content))
    except ValidationError as error:
        raise ConfigError(explain(error, NoiseModel, origins)) from None


def add_noise(
    ideal: Grid, step: int, shape: tuple[int, int], model: NoiseModel, *,
    rng: np.random.Generator, strength: float = 1.0,
) -> DisparityGrid:  # fmt: skip
    """Return what a scanner might have measured where the ideal disparities (h, w) are known.

    ``step`` and ``shape`` describe the grid and the rectified picture; ``strength`` is
    :func:`strength_on` what is seen.

    Raises
    ------
    ShapeError
        If ``ideal`` is no grid of 2 x 2 samples or more, or ``rng`` no generator.
    """
    if ideal.ndim != 2 or min(ideal.shape) < 2:
        raise ShapeError(f"ideal disparities have shape {ideal.shape}; give (h, w), 2 x 2 or more")
    if not isinstance(rng, np.random.Generator):
        raise ShapeError(f"rng = {rng!r}; give a generator: numpy.random.default_rng(0)")
    strength *= float(np.exp(model.pair_spread * rng.standard_normal()))
    near = model.correlation_px / step
    score = _correlated(ideal.shape, near, rng=rng)
    luck = _uniform(_correlated(ideal.shape, _HOLES * near, rng=rng))
    if model.long_part:
        far = _correlated(ideal.shape, model.long_px / step, rng=rng)
        score = np.sqrt(1 - model.long_part**2) * score + model.long_part * far
    law, away = laws(ideal, step), _beyond(ideal)
    errors, sigma = _errors(score, law, model)
    found = continued(smoothed(ideal, model.smooth_px / step), away) + strength * errors
    kept = luck < _matched_share(ideal, step, away, model, strength)
    return DisparityGrid(
        np.where(kept, found, np.nan).astype(np.float32),
        np.where(kept, strength * sigma, np.nan).astype(np.float32),
        np.where(kept, 0.95, 0).astype(np.float32),
        step,
        shape,
    )


def _errors(
    score: Grid, law: NDArray[np.int64], model: NoiseModel
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors (h, w), pixels, of normal scores under each sample's law, and the laws' deviations."""
    errors, sigma = np.zeros(score.shape), np.zeros(score.shape)
    low, high = SHARES.index(0.25), SHARES.index(0.75)
    for k, quantiles in enumerate(model.errors_px):
        own = law == k
        errors[own] = np.interp(score[own], SCORES, quantiles)
        sigma[own] = (quantiles[high] - quantiles[low]) / (SCORES[high] - SCORES[low])
    return errors, sigma


def _matched_share(
    ideal: Grid, step: int, away: NDArray[np.int64], model: NoiseModel, strength: float
) -> NDArray[np.float64]:
    """Chance (h, w) that a sample is matched."""
    share = np.array(model.slope_share)[slope_bin(ideal, step)]
    share = 1 - np.minimum(strength**2 * (1 - share), 1)
    inside = share * np.array(model.edge_share)[edge_bin(away == 0, len(model.edge_share))]
    outside = np.array([0.0, *model.fringe_share, 0.0])[np.minimum(away, FRINGE + 1)]
    return np.where(away == 0, inside, outside)


def laws(ideal: Grid, step: int) -> NDArray[np.int64]:
    """Return the number (h, w) of the law of each sample's errors; see :data:`LAWS`."""
    known = np.isfinite(ideal)
    ring = edge_bin(known, RINGS + 1)
    inside = np.where(ring < RINGS, ring, RINGS + slope_bin(ideal, step))
    return np.where(known, inside, LAWS - 1)


def _beyond(ideal: Grid) -> NDArray[np.int64]:
    """How many samples (h, w) beyond an edge a sample lies; 0 where the disparity is known."""
    away = cv2.distanceTransform((~np.isfinite(ideal)).astype(np.uint8), cv2.DIST_C, 3)
    return np.minimum(np.rint(np.minimum(away, ideal.size)), FRINGE + 1).astype(np.int64)


def continued(disparity: Grid, away: NDArray[np.int64] | None = None) -> Grid:
    """Continue disparities (h, w) beyond edges with those of the nearest sample within."""
    away = _beyond(disparity) if away is None else away
    if not (away == 0).any():
        return disparity
    row, column = distance_transform_edt(away > 0, return_distances=False, return_indices=True)
    return np.where(away <= FRINGE, disparity[row, column], np.float32(np.nan))


def beyond_share(measured: Grid, ideal: Grid) -> NDArray[np.float64]:
    """Count matched and all samples, (2, FRINGE), by how far they lie beyond an edge."""
    away = _beyond(ideal)
    each = [away == k + 1 for k in range(FRINGE)]
    return np.array([[np.isfinite(measured[e]).sum() for e in each], [e.sum() for e in each]])


def slope_bin(disparity: Grid, step: int) -> NDArray[np.int64]:
    """Bin (h, w) of the slope's size, 0 where it is unknown."""
    along = [np.gradient(disparity, step, axis=axis) for axis in (0, 1)]
    size = np.nan_to_num(np.hypot(*along))
    return np.asarray(np.searchsorted(np.array(SLOPES[:-1]), size))


def edge_bin(known: NDArray[np.bool_], bins: int) -> NDArray[np.int64]:
    """Distance (h, w) to the nearest unknown sample in samples, less one, at most ``bins - 1``."""
    away = cv2.distanceTransform(known.astype(np.uint8), cv2.DIST_C, 3)
    away = np.minimum(away, bins)  # infinite where nothing is unknown
    return np.clip(np.rint(away).astype(np.int64) - 1, 0, bins - 1)


def smoothed(disparity: Grid, sigma: float) -> Grid:
    """Gaussian mean (h, w) over known neighbours; sigma in samples."""
    if sigma < 0.05:
        return disparity
    known = np.isfinite(disparity)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma)
    mean = cv2.GaussianBlur(np.where(known, disparity, 0).astype(np.float32), (0, 0), sigma)
    return np.asarray(np.where(known, mean / np.maximum(weight, 1e-6), np.nan), np.float32)


def _correlated(shape: Any, sigma: float, *, rng: np.random.Generator) -> Grid:
    """White noise smoothed by a Gaussian of ``sigma`` samples, unit variance."""
    white = np.asarray(rng.standard_normal(shape), np.float32)
    if sigma < 0.2:
        return white
    smooth = cv2.GaussianBlur(white, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return np.asarray(smooth / max(float(smooth.std()), 1e-6), np.float32)


def _uniform(normal: Grid) -> Grid:
    """Turn normal values into their ranks in 0..1."""
    order = np.argsort(normal, axis=None)
    rank = np.empty(normal.size, np.float32)
    rank[order] = (np.arange(normal.size) + 0.5) / normal.size
    return np.asarray(rank.reshape(normal.shape))
