"""Where rectified pictures lie beside their disparities, both of them together.

Pictures that are shifted alike still match each other, but at every pixel by the disparity of the
next one: where the surface slopes, the match is off by the shift times the slope. So the offsets
at which the two pictures match, regressed on the slopes of the disparities, tell the shift. The
witness shares no code with the scanner: offsets are of Lucas and Kanade's kind (1981), from the
pictures' gradients.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.verify.disparities import shift
from synthgen.verify.report import Record
from synthgen.verify.stereo_pair import FEWEST, Pair

Array = NDArray[np.float64]
Image = NDArray[Any]

PICTURES, MEASURED = "stereo picture place", "disparity place"
# Pixels. Of 14 sound pairs of two rigs pictures are found at most 0.04 beside the measured
# disparities, and these 0.12 to the right of the true ones (0.17 at half resolution); of pictures
# half a pixel off 0.41-0.59.
# Down measured ones may lie 0.4 beside the true: a calibration's rows do not quite correspond.
PLACE_PX, MEASURED_PX = 0.25, 0.3
WINDOW = 9
# What can be told of a window: it is lit, the pictures match, and the surface is one and not steep.
LIT, ALIKE, STEEP, FAR_PX = 4.0, 0.6, 1.5, 1.0
UNSURE_PX, LEAST_PX, TOGETHER = 0.05, 0.01, 2.0  # windows overlap: errors of neighbours are alike
# A matcher's errors are alike over whole fingers: standard errors by leaving out bands of the
# picture. Of units of hand5 0.04-0.10; of one depth camera, found 0.46 beside the truth, 0.20.
BANDS, WAVERING_PX = 8, 0.12
FLAT = "the surface that both cameras see does not slope enough to tell"
VARIED = "the matcher's errors differ too much over the picture, or its surface slopes too little"


def check_place(record: Record, pair: Pair) -> None:
    """Check that both pictures lie where their disparities, measured or true, say."""
    unit = pair.stored
    if unit.left is None or unit.right is None:
        record.skip(PICTURES, "no pictures are stored")
        return
    move = placed(*offsets(unit.left, unit.right, unit.disparity, unit.step))
    if unit.true_disparity is not None and not np.isfinite(move).any():
        move = placed(*offsets(unit.left, unit.right, unit.true_disparity, unit.step))[:1]
    if np.isfinite(move).any():
        record.measure(PICTURES, np.nanmax(np.abs(move)), PLACE_PX,
                       "px (right, down) by which both pictures are shifted")  # fmt: skip
    else:
        record.skip(PICTURES, FLAT)


def check_measured_place(record: Record, pair: Pair) -> None:
    """Check that measured disparities do not lie to the right or left of the true ones."""
    unit, truth = pair.stored, pair.stored.true_disparity
    if truth is None:
        record.skip(MEASURED, "no true disparities are stored")
        return
    off = (unit.disparity - truth).astype(np.float64)
    down, across = np.gradient(truth.astype(np.float64))
    slope = np.stack([across, down], axis=-1) / unit.step
    used = (np.abs(off) < FAR_PX) & (np.abs(slope).max(axis=-1) < STEEP)
    move = placed(off[used], slope[used])[0]
    if np.isfinite(move) and wavering(off[used], slope[used])[0] < WAVERING_PX:
        record.measure(MEASURED, abs(move), MEASURED_PX,
                       "px to the right by which measured disparities are shifted")  # fmt: skip
    else:
        record.skip(MEASURED, VARIED)


def placed(off: Array, slope: Array) -> Array:
    """By how many pixels right and down (2,) both pictures are shifted; NaN where unsure."""
    if len(off) < FEWEST:
        return np.full(2, np.nan)
    fitted = shift(off, slope)
    rest = off - fitted[0] - slope @ fitted[1:]
    near = np.abs(rest) < 3 * max(np.median(np.abs(rest)) / 0.6745, LEAST_PX)
    fitted = shift(off[near], slope[near])
    columns = np.column_stack([np.ones(near.sum()), slope[near]])
    known = columns.T @ columns
    spread = np.linalg.inv(known + 1e-9 * np.trace(known) * np.eye(3))  # where nothing slopes
    scatter = max(float(rest[near].std()), LEAST_PX)
    error = TOGETHER * scatter * np.sqrt(np.diag(spread))[1:]
    return np.where(error < UNSURE_PX, -fitted[1:], np.nan)


def wavering(off: Array, slope: Array) -> Array:
    """Return standard errors (2,), pixels, of such a shift: by how much bands of a picture differ.

    The samples are in the order of the picture's rows.
    """
    bands = np.array_split(np.arange(len(off)), BANDS)
    moves = np.array([shift(np.delete(off, b), np.delete(slope, b, axis=0))[1:] for b in bands])
    return np.asarray(np.sqrt((BANDS - 1) * moves.var(axis=0)))


def offsets(
    left: NDArray[np.uint8], right: NDArray[np.uint8], grid: NDArray[Any], step: int
) -> tuple[Array, Array]:
    """Offsets (n,) of the right picture from the disparities, and the disparities' slopes (n, 2).

    Of windows of 9 x 9 pixels that lie on one surface; slopes are per pixel, right and down.
    """
    at = np.indices(left.shape).astype(np.float32)
    rows, columns = at[0], at[1]
    known = np.isfinite(grid)
    x, y = columns / np.float32(step), rows / np.float32(step)
    filled = np.where(known, grid, 0).astype(np.float32)
    disparity = cv2.remap(filled, x, y, cv2.INTER_LINEAR)
    whole = cv2.remap(known.astype(np.float32), x, y, cv2.INTER_LINEAR) > 0.999
    there = columns - disparity
    whole &= (there > 1) & (there < left.shape[1] - 2)
    one, other = left.astype(np.float32), right.astype(np.float32)
    ahead = (np.roll(other, -1, axis=1) - np.roll(other, 1, axis=1)) / 2
    two, gradient = (cv2.remap(image, there, rows, cv2.INTER_CUBIC) for image in (other, ahead))
    off, sure = _lucas_kanade(one, two, gradient)
    down, across = np.gradient(disparity)
    steep = np.maximum(np.abs(across), np.abs(down)) > STEEP
    solid = cv2.erode((whole & ~steep).astype(np.uint8), np.ones((WINDOW, WINDOW), np.uint8)) > 0
    used = np.zeros(left.shape, dtype=bool)
    used[:: WINDOW // 2, :: WINDOW // 2] = True
    used &= solid & sure & (np.abs(off) < FAR_PX)
    slope = np.stack([_mean(across), _mean(down)], axis=-1)
    return off[used].astype(np.float64), slope[used].astype(np.float64)


_mean: Callable[[Any], Any] = partial(cv2.blur, ksize=(WINDOW, WINDOW))


def _lucas_kanade(one: Image, two: Image, gradient: Image) -> tuple[Image, NDArray[np.bool_]]:
    """By how much ``two`` is to be moved to look like ``one`` (h, w), and where that is known.

    ``gradient`` is that of ``two`` as it was taken. Contrast and brightness of windows may differ.
    """
    lit = [np.maximum(_mean(image * image) - _mean(image) ** 2, 1e-6) for image in (one, two)]
    alike = (_mean(one * two) - _mean(one) * _mean(two)) / np.sqrt(lit[0] * lit[1])
    gain = np.sqrt(lit[0] / lit[1])
    rest = (one - _mean(one)) - gain * (two - _mean(two))
    ahead = (np.roll(one, -1, axis=1) - np.roll(one, 1, axis=1)) / 2
    slope = (gain * (gradient - _mean(gradient)) + ahead) / 2
    off = -_mean(rest * slope) / np.maximum(_mean(slope * slope), 1e-6)
    return off, (alike > ALIKE) & (lit[0] > LIT)
