"""The scanner's noise without its pictures: a model of matching errors, fitted to measured ones.

Residuals of a matcher (measured minus ideal disparity) are no white noise: within a window they
are one error, with slant they change, near edges samples are missing and bent, and on dark skin,
where gloss has more of the light, all gets worse. The model has just these: white noise smoothed to
the window's scale, a part of it to a longer one, a standard deviation per slope of the disparity, a
share of wilder errors, smoothing of the shape itself, the chance that a sample is matched at all by
its distance from the nearest edge and by its slope, and a power of the reflectance.
``benchmarks/scanner_noise.py`` fits it; the results are ``scenes/noise/*.yaml``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from synthgen.config import data_folder
from synthgen.config.explain import explain
from synthgen.config.reading import read_yaml
from synthgen.config.sections import Section
from synthgen.errors import ConfigError, ShapeError, nearest
from synthgen.scanner.match import DisparityGrid

Grid = NDArray[np.float32]
SLOPES = (0.1, 0.2, 0.3, 0.45, 0.7)
"""Upper ends of the bins of slope (pixels of disparity per pixel); the last bin is open."""

DARKEST = 0.02
# Holes hang together over this many times the way of the errors.
_HOLES = 2
_Positive = Annotated[float, Field(ge=0.0, le=20.0)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]


class NoiseModel(Section):
    """Matching errors of one scanner, in pixels of its rectified pictures."""

    step: int = Field(ge=1, le=16)
    """Pixels between the samples that it was fitted on."""

    sigma_px: tuple[_Positive, ...]
    """Standard deviation of the disparity per bin of slope."""

    wild_share: _Share
    """Share of samples with a wilder error."""

    wild_factor: float = Field(ge=1.0, le=100.0)
    """How many times wilder."""

    correlation_px: _Positive
    """Standard deviation of the Gaussian that white noise is smoothed with."""

    long_part: _Share = 0.0
    """Standard deviation, in ``sigma_px``, of what hangs together over a longer way."""

    long_px: float = Field(default=60.0, ge=1.0, le=500.0)
    """Standard deviation of the Gaussian of that part."""

    smooth_px: _Positive
    """Standard deviation of the Gaussian that the shape is smoothed with."""

    edge_share: tuple[_Share, ...]
    """Share of samples matched at 1, 2, 3, ... samples from the nearest edge; the last holds on."""

    slope_share: tuple[_Share, ...]
    """Share of samples matched per bin of slope, away from edges."""

    albedo: float = Field(default=0.3, gt=0.0, le=1.0)
    """Grey reflectance for which all this holds."""

    albedo_power: float = Field(default=0.0, ge=0.0, le=2.0)
    """Errors grow as the reflectance to minus this, the share that is not matched as its square."""

    def strength(self, albedo: float) -> float:
        """Return how many times larger the errors are on a surface of some grey reflectance."""
        return float((max(albedo, DARKEST) / self.albedo) ** -self.albedo_power)


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
    :meth:`NoiseModel.strength` of the surface.

    Raises
    ------
    ShapeError
        If ``ideal`` is no grid of 2 x 2 samples or more, or ``rng`` no generator.
    """
    if ideal.ndim != 2 or min(ideal.shape) < 2:
        raise ShapeError(f"ideal disparities have shape {ideal.shape}; give (h, w), 2 x 2 or more")
    if not isinstance(rng, np.random.Generator):
        raise ShapeError(f"rng = {rng!r}; give a generator: numpy.random.default_rng(0)")
    known = np.isfinite(ideal)
    sigma = strength * np.array(model.sigma_px)[slope_bin(ideal, step)]
    near = model.correlation_px / step
    noise = _correlated(ideal.shape, near, rng=rng)
    wild = _correlated(ideal.shape, near, rng=rng)
    limit = np.quantile(np.abs(wild), 1 - model.wild_share) if model.wild_share else np.inf
    noise = noise * np.where(np.abs(wild) > limit, np.float32(model.wild_factor), np.float32(1))
    luck = _uniform(_correlated(ideal.shape, _HOLES * near, rng=rng))
    if model.long_part:
        far = _correlated(ideal.shape, model.long_px / step, rng=rng)
        whole = 1 + model.wild_share * (model.wild_factor**2 - 1)
        noise = np.sqrt(1 - model.long_part**2 / whole) * noise + model.long_part * far
    found = smoothed(ideal, model.smooth_px / step) + sigma * noise
    share = np.array(model.slope_share)[slope_bin(ideal, step)]
    share = 1 - np.minimum(strength**2 * (1 - share), 1)
    edge = np.array(model.edge_share)[edge_bin(known, len(model.edge_share))]
    kept = known & (luck < share * edge)
    return DisparityGrid(
        np.where(kept, found, np.nan).astype(np.float32),
        np.where(kept, sigma, np.nan).astype(np.float32),
        np.where(kept, 0.95, 0).astype(np.float32),
        step,
        shape,
    )


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
