"""From a rectified pair to disparities: a seed on every pixel, checks, refinement on a grid."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ScanError, ShapeError
from synthgen.scanner.dic import refine
from synthgen.scanner.dic_reference import DicSettings
from synthgen.scanner.spreading import predicted

Image = NDArray[np.float32]
LARGEST_BEND = 0.02
"""Second derivatives of disparity beyond this, per pixel, are no surface: the correction stops."""

COARSE, WIDE_PX, MARGIN_PX, SLACK_PX = 4, 128, 12, 2
_LEAST_NEIGHBOURS, _NEAR_PX = 3, 5
# Samples; less lets the slopes' noise into the disparities.
_SLOPE_BLUR = 1.2


@dataclass(frozen=True)
class MatchSettings:
    """How a pair is matched.

    Attributes
    ----------
    step : int
        Grid spacing of the result, pixels.
    block : int
        Edge of the seed matcher's block, odd, pixels.
    seed_scale : {1, 2}
        The seed is found at full or half resolution; the refinement bridges the rest.
    texture : float
        Least local standard deviation of the left picture, in counts of 0..255.
    bright : float
        Least local mean, in counts of 0..255: what is darker is background.
    correlation : float
        Least correlation of a refined window.
    sure : float
        Below this correlation a sample needs ``sure_neighbours`` known neighbours that predict it
        to ``sure_px``: dark skin is noisy all over, while windows over an edge lack neighbours.
    sure_neighbours : int
    sure_px : float
        Pixels.
    sweeps : int
        How often matching goes on from what was matched into what was not.
    agreement_px : float
        Largest difference of a disparity from what its neighbours predict.
    rows : int
        How many rows above and below points are looked for, where the calibration's rows may not
        correspond; 0 trusts it.
    correct_curvature : bool
        Remove the bias of the affine shape function on curved surfaces.
    dic : DicSettings
    """

    step: int = 3
    block: int = 9
    seed_scale: int = 2
    texture: float = 2.0
    bright: float = 6.0
    correlation: float = 0.6
    sure: float = 0.845
    sure_neighbours: int = 7
    sure_px: float = 0.15
    sweeps: int = 8
    agreement_px: float = 0.3
    rows: int = 0
    correct_curvature: bool = True
    dic: DicSettings = field(default_factory=DicSettings)


FAST = MatchSettings()
BEST = MatchSettings(dic=DicSettings(window=19, order=2, iterations=6), correct_curvature=False)


@dataclass(frozen=True, eq=False)
class DisparityGrid:
    """Disparities of a pair on a grid of its left view; NaN where nothing was matched.

    Attributes
    ----------
    disparity : (h, w) float32, pixels of the rectified view
        Sample (r, c) belongs to pixel ``x = step * c, y = step * r``.
    sigma : (h, w) float32
        Its standard error, pixels (sub-pixel confidence: smaller is surer).
    correlation : (h, w) float32
        0 where nothing was matched.
    step : int
    shape : (height, width)
        Of the rectified view.
    """

    disparity: Image
    sigma: Image
    correlation: Image
    step: int
    shape: tuple[int, int]

    @property
    def matched(self) -> NDArray[np.bool_]:
        """(h, w) where there is a disparity."""
        return np.isfinite(self.disparity)


def match(
    left: NDArray[Any], right: NDArray[Any], bounds: tuple[float, float], settings: MatchSettings
) -> DisparityGrid:
    """Match a rectified pair.

    Parameters
    ----------
    left, right : (H, W) float
        Rectified, 0..255.
    bounds : (float, float)
        Lowest and highest disparity of the working volume, pixels.
    settings : MatchSettings

    Raises
    ------
    ShapeError
        If the pictures differ in size or the bounds are not in order.
    ScanError
        If no pixel is bright and textured: the projector lights nothing.
    """
    if left.shape != right.shape or left.ndim != 2:
        raise ShapeError(f"pictures of shapes {left.shape} and {right.shape}; two equal (H, W)")
    if not bounds[0] < bounds[1]:
        raise ShapeError(f"disparity bounds {bounds} px; the lower one must come first")
    seed = seed_disparity(left, right, narrowed(left, right, bounds, settings), settings)
    step = settings.step
    start = seed[::step, ::step]
    wanted = lit(left, settings)[::step, ::step]
    samples = np.full((*start.shape, 5), np.nan, np.float32)
    todo = np.isfinite(start)
    _refine_into(samples, todo, left, right, start[todo], tilt_of(start, step)[todo], settings)
    for _ in range(settings.sweeps):
        _drop_doubtful(samples, settings)
        todo = wanted & ~np.isfinite(samples[..., 0])
        guess, lean, count = predicted(samples[..., 0], samples[..., 1:3], step, todo)
        known = count >= _LEAST_NEIGHBOURS
        todo[todo] = known
        _refine_into(samples, todo, left, right, guess[known], lean[known], settings)
    _drop_doubtful(samples, settings)
    grid = samples[..., 0]
    if settings.correct_curvature and settings.dic.order == 1:
        grid = grid - bend_bias(samples[..., 1:3], step, settings.dic.second_moment)
    height, width = left.shape
    correlation = np.nan_to_num(samples[..., 4])
    return DisparityGrid(grid, samples[..., 3].copy(), correlation, step, (height, width))


def _refine_into(
    samples: Image, todo: NDArray[np.bool_], left: NDArray[Any], right: NDArray[Any],
    start: NDArray[Any], lean: NDArray[Any], settings: MatchSettings,
) -> None:  # fmt: skip
    """Refine some samples; writes disparity, slope (2), sigma, correlation where it succeeds."""
    rows, columns = np.nonzero(todo)
    xy = np.stack([columns, rows], axis=1) * settings.step
    found = refine(left, right, xy, start, settings.dic, lean)
    good = found.valid & (found.correlation >= settings.correlation)
    values = np.column_stack([found.disparity, found.slope, found.sigma, found.correlation])
    samples[rows[good], columns[good]] = values[good]


def _drop_doubtful(samples: Image, settings: MatchSettings) -> None:
    """Forget samples that most of their neighbours contradict, and poor ones without support."""
    known = np.isfinite(samples[..., 0])
    guess, _, count = predicted(samples[..., 0], samples[..., 1:3], settings.step, known)
    off = np.abs(samples[known, 0] - guess)
    contradicted = (off > settings.agreement_px) & (count >= _LEAST_NEIGHBOURS)
    backed = (off <= settings.sure_px) & (count >= settings.sure_neighbours)
    poor = samples[known, 4] < settings.sure
    bad = np.zeros_like(known)
    bad[known] = contradicted | (poor & ~backed)
    samples[bad] = np.nan


def tilt_of(seed: Image, step: int) -> Image:
    """Return slopes (h, w, 2) of seeds: gradients of the smoothed seeds, 0 where unknown."""
    known = np.isfinite(seed)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), 2.0)
    mean = cv2.GaussianBlur(np.where(known, seed, 0).astype(np.float32), (0, 0), 2.0)
    smooth = np.where(weight > 0.6, mean / np.maximum(weight, 1e-6), np.nan)
    down, across = np.gradient(smooth, step)
    tilt = np.nan_to_num(np.stack([across, down], axis=-1))
    return np.asarray(np.clip(tilt, -0.8, 0.8), np.float32)


def seed_disparity(
    left: NDArray[Any], right: NDArray[Any], bounds: tuple[float, float], settings: MatchSettings
) -> Image:
    """Semi-global matching (OpenCV, three-way), left-right and texture checks; NaN where unsure."""
    mask = lit(left, settings)
    if not mask.any():
        raise ScanError(
            f"no pixel of the left picture is brighter than {settings.bright:g} and varies by "
            f"{settings.texture:g} counts (its mean is {float(np.mean(left)):.2g}): the projectors "
            "light nothing here; check their power, distance and aim, and the exposure"
        )
    scale = settings.seed_scale
    low = int(np.floor(bounds[0] / scale)) - 1
    count = int(np.ceil((bounds[1] - bounds[0]) / scale / 16 + 0.2)) * 16
    y, x = np.nonzero(mask)
    margin = 2 * settings.block
    top, bottom = max(0, y.min() - margin), y.max() + margin + 1
    first, last = max(0, x.min() - margin), x.max() + margin + 1
    crop = slice(top, bottom), slice(first, last)
    pad = scale * (max(0, low + count) + 8), scale * (max(0, -low) + 8)
    pictures = [_window(image, crop, pad, scale) for image in (left, right)]
    found = _semi_global(pictures[0], pictures[1], low, count, settings.block)
    found = found[:, pad[0] // scale : found.shape[1] - pad[1] // scale] * scale
    if scale > 1:
        found = _enlarge(found, mask[crop].shape)
    # The matcher searches in steps of 16: what it finds beyond the bounds is not wanted.
    inside = (found >= bounds[0] - SLACK_PX) & (found <= bounds[1] + SLACK_PX)
    seed = np.full(left.shape, np.nan, np.float32)
    seed[crop] = np.where(mask[crop] & inside, found, np.nan)
    return seed


def narrowed(
    left: NDArray[Any], right: NDArray[Any], bounds: tuple[float, float], settings: MatchSettings
) -> tuple[float, float]:
    """Return the part of wide bounds that a look at quarter resolution finds used, with a margin.

    The working volume's range is several times the subject's; the seed's cost grows with it.
    """
    if bounds[1] - bounds[0] <= WIDE_PX or min(left.shape) < 40 * COARSE:
        return bounds
    height, width = (n // COARSE for n in left.shape)
    size = (width, height)
    pictures = [
        cv2.resize(image[: height * COARSE, : width * COARSE], size, interpolation=cv2.INTER_AREA)
        for image in (np.asarray(left, np.float32), np.asarray(right, np.float32))
    ]
    mask = cv2.blur(pictures[0], (5, 5)) > settings.bright
    count = int(np.ceil((bounds[1] - bounds[0]) / COARSE / 16 + 0.2)) * 16
    low = int(np.floor(bounds[0] / COARSE)) - 1
    pad = max(0, low + count) + 2, max(0, -low) + 2
    whole = slice(0, height), slice(0, width)
    one, two = (_window(p, whole, pad, 1) for p in pictures)
    found = _semi_global(one, two, low, count, 5)
    used = found[:, pad[0] : pad[0] + width][mask]
    used = used[np.isfinite(used)] * COARSE
    if len(used) < 0.1 * mask.sum() or len(used) < 50:
        return bounds
    near, far = np.quantile(used, [0.002, 0.998])
    return max(bounds[0], float(near) - MARGIN_PX), min(bounds[1], float(far) + MARGIN_PX)


def lit(left: NDArray[Any], settings: MatchSettings) -> NDArray[np.bool_]:
    """Where a block of the picture (H, W) is bright and textured enough to match."""
    size = (settings.block, settings.block)
    image = np.asarray(left, np.float32)
    mean = cv2.blur(image, size)
    spread = cv2.blur(image * image, size) - mean * mean
    bright = cv2.blur(image, (_NEAR_PX, _NEAR_PX)) > settings.bright
    return np.asarray(bright & (mean > settings.bright) & (spread > settings.texture**2))


def _window(
    image: NDArray[Any], crop: tuple[slice, slice], pad: tuple[int, int], scale: int
) -> NDArray[np.uint8]:
    """Rows of the crop, columns of the crop and the padding: from the picture, else repeated."""
    first, last = crop[1].start - pad[0], crop[1].stop + pad[1]
    inside = image[crop[0], max(0, first) : min(last, image.shape[1])]
    stop = min(crop[1].stop, image.shape[1])
    right = max(0, stop + pad[1] - image.shape[1])
    wide = cv2.copyMakeBorder(
        np.clip(np.rint(inside), 0, 255).astype(np.uint8), 0, 0, max(0, -first), right,
        cv2.BORDER_REPLICATE,
    )  # fmt: skip
    if scale == 1:
        return np.asarray(wide)
    height, width = (-(-n // scale) * scale for n in wide.shape)
    even = cv2.copyMakeBorder(
        wide, 0, height - wide.shape[0], 0, width - wide.shape[1], cv2.BORDER_REPLICATE
    )
    size = (width // scale, height // scale)
    return np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA))


def _semi_global(
    left: NDArray[np.uint8], right: NDArray[np.uint8], low: int, count: int, block: int
) -> Image:
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=block,
        P1=8 * block * block,
        P2=32 * block * block,
        disp12MaxDiff=1,
        uniquenessRatio=5,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    raw = matcher.compute(left, right).astype(np.float32) / 16
    return np.where(raw > low - 0.5, raw, np.nan).astype(np.float32)


def _enlarge(small: Image, shape: tuple[int, int]) -> Image:
    """Twice the size, cut to ``shape``; each pixel takes its parent's value."""
    return np.repeat(np.repeat(small, 2, axis=0), 2, axis=1)[: shape[0], : shape[1]]


def bend_bias(slope: NDArray[Any], step: int, second_moment: float) -> Image:
    """Return what an affine window adds to the disparity of a curved surface (h, w), pixels.

    A plane fitted to ``d + (dxx x^2 + dyy y^2) / 2`` under a window of second moment m returns
    ``d + m (dxx + dyy) / 2``: convex surfaces come out too far. The second derivatives are taken
    from the gradients ``slope`` (h, w, 2) that the neighbours' fits returned.
    """
    bend = np.zeros(slope.shape[:2], np.float32)
    for axis, component in ((1, slope[..., 0]), (0, slope[..., 1])):
        smooth = _blur_known(component)
        ahead, behind = np.roll(smooth, -1, axis), np.roll(smooth, 1, axis)
        change = (ahead - behind) / (2 * step)
        edge = (slice(None), [0, -1]) if axis == 1 else ([0, -1], slice(None))
        change[edge] = 0
        bend += np.nan_to_num(change).astype(np.float32)
    return np.asarray(second_moment / 2 * np.clip(bend, -LARGEST_BEND, LARGEST_BEND), np.float32)


def _blur_known(values: NDArray[Any]) -> Image:
    """Gaussian mean (1.2 samples) over the known neighbours; NaN where the sample is unknown."""
    known = np.isfinite(values)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), _SLOPE_BLUR)
    mean = cv2.GaussianBlur(np.where(known, values, 0).astype(np.float32), (0, 0), _SLOPE_BLUR)
    return np.where(known, mean / np.maximum(weight, 1e-6), np.nan).astype(np.float32)
