"""Rows that do not correspond: known, or found in the pictures of a pair, and put right.

Cameras that look at different angles through a slab of glass see a point in different rows; the
slab is known, and so is by how much. A calibration that is off by more than some tenths of a pixel
shifts one picture's rows against the other's, and matching along rows fails. As scanners do that
align themselves by what they see, small windows of the left picture are looked for in the right one
over neighbouring rows as well; a plane through their row offsets says how the right picture is to
be read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.scanner.calibration import in_frame, volume_points
from synthgen.scanner.glass import thickness_for
from synthgen.scanner.ideal import project_through
from synthgen.scanner.match import MatchSettings, lit
from synthgen.scanner.rectify import Rectified, rectified_pixels
from synthgen.scanner.rig import Glass, Vec3

Array = NDArray[np.float64]
WINDOW_PX, WINDOWS = 21, 400
LEAST_WINDOWS, LEAST_CORRELATION = 20, 0.6
_SLACKS_PX = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.15)


@dataclass(frozen=True)
class RowOffset:
    """How far below its row in the left picture a point lies in the right one, pixels.

    ``middle + across * u + down * v``, where u and v go from -1 to 1 over the picture.

    Attributes
    ----------
    middle, across, down : float
    windows : int
        Of the picture that agree with it; 0 where it is known.
    """

    middle: float
    across: float
    down: float
    windows: int

    def over(self, shape: tuple[int, ...]) -> Array:
        """Return the offset of every pixel of pictures of a shape (H, W)."""
        height, width = shape
        u, v = np.linspace(-1, 1, width), np.linspace(-1, 1, height)[:, None]
        return np.asarray(self.middle + self.across * u + self.down * v)


def refracted_rows(pair: Rectified, glass: Glass | None, volume_m: Vec3) -> RowOffset | None:
    """Return the row offset that glass makes, over the working volume above it; None without."""
    eyes = pair.left, pair.right
    if glass is None or not any(thickness_for(glass, eye.position) for eye in eyes):
        return None
    points = volume_points(volume_m, 9)
    points = points[points[:, 1] >= glass.top_m]
    points = points[in_frame(pair.left, points) & in_frame(pair.right, points)]
    if len(points) < LEAST_WINDOWS:
        return None
    a, b = (
        rectified_pixels(pair, k, project_through(glass, eye, points)) for k, eye in enumerate(eyes)
    )
    u, v = (2 * b / [pair.camera.width - 1, pair.camera.height - 1] - 1).T
    basis = np.column_stack([np.ones_like(u), u, v])
    middle, across, down = np.linalg.lstsq(basis, (b - a)[:, 1], rcond=None)[0].tolist()
    return RowOffset(middle, across, down, 0)


def find_row_offset(
    left: NDArray[Any], right: NDArray[Any], bounds: tuple[float, float], settings: MatchSettings
) -> RowOffset | None:
    """Measure the row offset of a rectified pair.

    Parameters
    ----------
    left, right : (H, W) float
        Rectified, 0..255.
    bounds : (float, float)
        Lowest and highest disparity, pixels.
    settings : MatchSettings
        ``rows`` above and below are searched.

    Returns
    -------
    RowOffset or None
        None where no rows are searched, or fewer than 20 windows are found again.
    """
    if not settings.rows:
        return None
    found = [
        found
        for x, y in _centres(lit(left, settings))
        if (found := _look(left, right, int(x), int(y), bounds, settings.rows)) is not None
    ]
    if len(found) < LEAST_WINDOWS:
        return None
    x, y, offset = np.array(found).T
    height, width = left.shape
    u, v = 2 * x / (width - 1) - 1, 2 * y / (height - 1) - 1
    return _plane(u, v, offset)


def _centres(mask: NDArray[np.bool_]) -> Array:
    """Choose up to 400 lit pixels (n, 2), evenly over the picture, x and y."""
    half = WINDOW_PX // 2
    step = max(2, int(np.sqrt(mask.sum() / WINDOWS)))
    y, x = np.nonzero(mask[half:-half:step, half:-half:step])
    return np.asarray(np.stack([x, y], axis=1) * step + half, np.float64)


def _look(
    left: NDArray[Any], right: NDArray[Any], x: int, y: int, bounds: tuple[float, float], rows: int
) -> tuple[float, float, float] | None:
    """Find one window again: its place in the right picture, and its row offset there."""
    half, reach = WINDOW_PX // 2, rows + 1
    first = int(np.floor(x - bounds[1])) - half - 1
    last = int(np.ceil(x - bounds[0])) + half + 2
    first, last = max(first, 0), min(last, right.shape[1])
    top, bottom = y - half - reach, y + half + reach + 1
    if top < 0 or bottom > right.shape[0] or last - first < WINDOW_PX:
        return None
    window = np.asarray(left[y - half : y + half + 1, x - half : x + half + 1], np.float32)
    strip = np.asarray(right[top:bottom, first:last], np.float32)
    score = cv2.matchTemplate(strip, window, cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(np.argmax(score)), score.shape)
    if score[row, column] < LEAST_CORRELATION or row in (0, 2 * reach):
        return None
    above, best, below = (float(score[row + k, column]) for k in (-1, 0, 1))
    bend = above - 2 * best + below
    shift = 0.5 * (above - below) / bend if bend < 0 else 0.0
    return first + int(column) + half, y, float(row) - reach + shift


def _plane(u: Array, v: Array, offset: Array) -> RowOffset:
    """Fit a plane that most offsets agree on: weights fall with the distance from it."""
    basis = np.column_stack([np.ones_like(u), u, v])
    plane = np.array([np.median(offset), 0.0, 0.0])
    for slack in _SLACKS_PX:
        weight = 1 / (1 + ((offset - basis @ plane) / slack) ** 2)
        plane = np.linalg.lstsq(basis * weight[:, None], offset * weight, rcond=None)[0]
    near = np.abs(offset - basis @ plane) < 2 * _SLACKS_PX[-1]
    middle, across, down = (float(value) for value in plane)
    return RowOffset(middle, across, down, int(near.sum()))
