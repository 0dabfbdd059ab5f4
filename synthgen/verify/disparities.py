"""Checks of disparities: against the true surface, the true cameras, and the pictures."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.raster import rasterise
from synthgen.scanner.glass import seen_position
from synthgen.verify.report import Record
from synthgen.verify.stereo_pair import FEWEST, Pair

Array = NDArray[np.float64]
Grid = NDArray[np.floating[Any]]

# Pixels of the rectified pictures. Of 31 sound pairs of three rigs, at half and full resolution:
# 80 % of the true disparities within 0.06 of the surface's, and shifted by at most 0.05; 70 % of
# the measured ones within 0.3 of the true ones, their median by at most 0.09; pictures correlate
# to 0.88 and more, at most 0.15 away.
TRUE_PX, SHIFT_PX, MEASURED_PX, OFFSET_PX = 0.3, 0.15, 1.5, 0.3
SHOWN, PICTURE_PX = 0.5, 0.3
_TURNS = np.arange(-1.5, 1.51, 0.25)
_WINDOW = 7
_PRECISE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)


def check_true_disparity(record: Record, pair: Pair) -> None:
    """Compare the true disparities with the true surface through the true cameras."""
    truth = pair.stored.true_disparity
    if truth is None or pair.unit is None:
        why = "no true disparities are stored" if truth is None else pair.unknown
        record.skip("true disparity", why)
        return
    at = [_rectified_pixels(pair, right) for right in (False, True)]
    stored, slope, place, smooth = _between(truth, at[0] / pair.stored.step)
    known = np.flatnonzero(smooth)
    known = known[_visible(pair, at[0])[place[known]]]
    if len(known) < FEWEST:
        record.skip("true disparity", "too little of the surface is seen by both cameras")
        return
    expected = (at[0] - at[1])[place[known], 0]
    off = stored[known] - expected
    record.measure("true disparity", np.quantile(np.abs(off), 0.8), TRUE_PX,
                   "px from the true surface through the true cameras (80 %)")  # fmt: skip
    near = np.abs(off) < TRUE_PX
    if near.sum() >= FEWEST:
        move = shift(off[near], slope[known][near] / pair.stored.step)
        record.measure("disparity grid", np.abs(move).max(), SHIFT_PX,
                       "px (disparity, right, down) by which they are shifted")  # fmt: skip


def _rectified_pixels(pair: Pair, right: bool) -> Array:
    """Where the true cameras see the vertices (V, 2), read with the nominal calibration."""
    assert pair.unit is not None
    true, nominal = ((c.right if right else c.left) for c in (pair.unit.true, pair.unit.nominal))
    eyes = seen_position(pair.glass, true.position, pair.vertices)
    local = (pair.vertices - eyes) @ true.T[:3, :3]
    still = np.zeros(3)
    raw, _ = cv2.projectPoints(local[:, None], still, still, true.K, np.array(true.distortion))
    view = pair.stored.pair.camera
    K = view.K
    K[0, 2] = pair.stored.pair.cx_right if right else view.cx
    flat: Any = cv2.undistortPoints(
        raw, nominal.K, np.array(nominal.distortion), None,
        view.T[:3, :3].T @ nominal.T[:3, :3], K, _PRECISE,
    )  # fmt: skip
    return np.asarray(flat[:, 0], np.float64)


def _visible(pair: Pair, at: Array) -> NDArray[np.bool_]:
    """Which vertices (V,) the left camera sees, by a z-buffer."""
    view = pair.stored.pair.camera
    depth = rasterise(pair.vertices, pair.faces, view)[2]
    own = (pair.vertices - view.position) @ view.T[:3, 2]
    c, r = np.clip(np.rint(at), 0, [view.width - 1, view.height - 1]).astype(np.int64).T
    return np.asarray(np.abs(depth[r, c] - own) < 1e-3)


def _between(grid: Grid, at: Array) -> tuple[Array, Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Read a grid (h, w) between its samples at columns and rows (n, 2).

    Returns
    -------
    values (m,), slopes (m, 2) per sample to the right and down, the rows (m,) of ``at`` that lie
    within the grid, and which of them lie on one surface.
    """
    place = np.flatnonzero(np.all((at >= 0) & (at < np.array(grid.shape[::-1]) - 1.001), axis=1))
    (c, r), (x, y) = np.floor(at[place]).astype(np.int64).T, (at[place] % 1).T
    a, b, d, e = (grid[r + j, c + i].astype(np.float64) for j in (0, 1) for i in (0, 1))
    top, bottom = a + x * (b - a), d + x * (e - d)
    slope = np.stack([(b - a) * (1 - y) + (e - d) * y, bottom - top], axis=1)
    corners = np.stack([a, b, d, e])
    smooth = np.isfinite(corners).all(axis=0)
    smooth &= np.ptp(np.where(np.isfinite(corners), corners, 0), axis=0) < 2
    return top + y * (bottom - top), slope, place, smooth


def shift(off: Array, slope: Array) -> Array:
    """Offset of disparities, and by how many pixels right and down they are shifted (3,)."""
    columns = np.column_stack([np.ones(len(off)), slope])
    return np.asarray(np.linalg.lstsq(columns, off, rcond=None)[0])


def check_disparity(record: Record, pair: Pair) -> None:
    """Compare the measured disparities with the true ones."""
    unit = pair.stored
    if unit.true_disparity is None:
        record.skip("disparity", "no true disparities are stored")
        return
    off = (unit.disparity - unit.true_disparity).astype(np.float64)
    off = off[np.isfinite(off)]
    if len(off) < FEWEST:
        record.skip("disparity", "the unit matched too little")
        return
    record.measure("disparity", np.quantile(np.abs(off), 0.7), MEASURED_PX,
                   "px between measured and true disparities (70 %)")  # fmt: skip
    record.measure("disparity offset", abs(np.median(off)), OFFSET_PX,
                   "px by which the measured disparities are off (median)")  # fmt: skip


def check_pictures(record: Record, pair: Pair) -> None:
    """Check that the right picture, moved by the true disparities, looks like the left one."""
    unit = pair.stored
    grid = unit.disparity if unit.true_disparity is None else unit.true_disparity
    if unit.left is None or unit.right is None:
        record.skip("stereo pictures", "no pictures are stored")
        return
    alike = np.array([found for turn in _TURNS
                      if (found := likeness(unit.left, unit.right, grid, unit.step, turn))
                      is not None])  # fmt: skip
    if len(alike) < len(_TURNS):
        record.skip("stereo pictures", "too little of the surface is lit and seen by both cameras")
        return
    best = float(alike.max())
    record.measure("stereo pictures", -best, -SHOWN,
                   f"the pictures correlate to {best:.2f} at the true disparities")  # fmt: skip
    if best >= SHOWN:
        record.measure("stereo picture shift", abs(_peak(alike)), PICTURE_PX,
                       "px between the right picture and the disparities")  # fmt: skip


def likeness(
    left: NDArray[np.uint8], right: NDArray[np.uint8], grid: Grid, step: int, turn: float
) -> float | None:
    """Median correlation of windows of 7 x 7 samples of a grid; None where too few are whole."""
    at = (np.indices(grid.shape) * step).astype(np.float32)
    r, c = at[0], at[1]
    known = np.isfinite(grid)
    one = left[::step, ::step].astype(np.float32)
    x = c - np.where(known, grid, 0).astype(np.float32) - np.float32(turn)
    two = cv2.remap(right.astype(np.float32), x, r, cv2.INTER_CUBIC)
    mean: Callable[[Any], Any] = partial(cv2.blur, ksize=(_WINDOW, _WINDOW))
    whole = mean(known.astype(np.float32)) > 0.999
    spread = [mean(image * image) - mean(image) ** 2 for image in (one, two)]
    whole &= spread[0] > 4  # counts of 0..255: lit
    if whole.sum() < FEWEST:
        return None
    both = mean(one * two) - mean(one) * mean(two)
    found = both[whole] / np.sqrt(np.maximum(spread[0] * spread[1], 1e-6))[whole]
    return float(np.median(found))


def _peak(alike: Array) -> float:
    """Where a parabola through the three best has its top, pixels."""
    k = int(np.clip(alike.argmax(), 1, len(alike) - 2))
    a, b, c = alike[k - 1 : k + 2]
    width = float(_TURNS[1] - _TURNS[0])
    return float(_TURNS[k] + width * (a - c) / (2 * (a - 2 * b + c)))
