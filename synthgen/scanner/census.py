"""The matcher of consumer depth cameras: census, semi-global matching, median.

Centre-symmetric census over 7x7, costs summed over 7x7, four paths with penalties 8 and 32,
uniqueness 15 %, left-right difference 1, median 3: the settings of common simulators of the D400
family (SimSense among them). They fit a parabola through the three best costs, whose disparities
crowd towards whole pixels by up to .1; numbers of differing bits rise in straight lines from where
pictures agree, so two lines of one steepness are fitted here, as such cameras, whose makers removed
that error, come out. A plain implementation in numba, one thread.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.scanner.match import DisparityGrid, MatchSettings, lit

HALF = 3
_SIGMA_PX = 0.1


@dataclass(frozen=True)
class CensusSettings:
    """Penalties in bits of the 24-bit descriptor, summed over the block.

    Attributes
    ----------
    block : int
        Edge over which costs are summed, odd.
    small_jump, large_jump : int
        Penalty of a disparity step of one, and of more.
    uniqueness : float
        The best cost must be lower than any other, not its neighbour, by this share.
    difference : int
        Largest left-right difference, pixels.
    """

    block: int = 7
    small_jump: int = 8
    large_jump: int = 32
    uniqueness: float = 0.15
    difference: int = 1


def match_census(
    left: NDArray[Any],
    right: NDArray[Any],
    bounds: tuple[float, float],
    settings: CensusSettings | None = None,
) -> DisparityGrid:
    """Match a rectified pair (H, W), 0..255, at every pixel."""
    s = settings or CensusSettings()
    low, high = int(np.floor(bounds[0])), int(np.ceil(bounds[1]))
    own, other = census(left), census(right)
    cost = _costs(own, other, low, high - low + 1)
    size = (s.block, s.block)
    for k in range(cost.shape[2]):
        cost[:, :, k] = cv2.boxFilter(cost[:, :, k], -1, size, normalize=False)
    total = _paths(cost, float(s.small_jump), float(s.large_jump))
    found = _pick(total, low, s.uniqueness, s.difference)
    known = np.isfinite(found)
    median = cv2.medianBlur(np.where(known, found, -999).astype(np.float32), 3)
    known &= (median > -999) & lit(left, MatchSettings(bright=0.0, texture=1.0))
    disparity = np.where(known, median, np.nan).astype(np.float32)
    sigma = np.where(known, _SIGMA_PX, np.nan).astype(np.float32)
    height, width = left.shape
    return DisparityGrid(disparity, sigma, known.astype(np.float32), 1, (height, width))


def census(image: NDArray[Any]) -> NDArray[np.uint32]:
    """Centre-symmetric descriptor (H, W): one bit per opposite pair of the 7x7 neighbourhood."""
    padded = np.pad(np.asarray(image, np.float32), HALF, mode="edge")
    height, width = image.shape
    bits = np.zeros((height, width), np.uint32)
    offsets = [(j, i) for j in range(-HALF, HALF + 1) for i in range(-HALF, HALF + 1)]
    for j, i in offsets[: len(offsets) // 2]:
        one = padded[HALF + j : HALF + j + height, HALF + i : HALF + i + width]
        two = padded[HALF - j : HALF - j + height, HALF - i : HALF - i + width]
        bits = (bits << np.uint32(1)) | (one > two).astype(np.uint32)
    return bits


@njit(cache=True)
def _costs(own: Any, other: Any, low: int, count: int) -> Any:
    """Hamming distances (H, W, count), 24 where the other picture ends; float32 for the filter."""
    height, width = own.shape
    cost = np.full((height, width, count), np.float32(24))
    for y in range(height):
        for x in range(width):
            for k in range(count):
                at = x - low - k
                if 0 <= at < width:
                    v = own[y, x] ^ other[y, at]
                    v = v - ((v >> np.uint32(1)) & np.uint32(0x55555555))
                    v = (v & np.uint32(0x33333333)) + ((v >> np.uint32(2)) & np.uint32(0x33333333))
                    v = (v + (v >> np.uint32(4))) & np.uint32(0x0F0F0F0F)
                    bits = (v * np.uint32(0x01010101) & np.uint32(0xFFFFFFFF)) >> np.uint32(24)
                    cost[y, x, k] = np.float32(bits)
    return cost


@njit(cache=True)
def _paths(cost: Any, small: float, large: float) -> Any:
    """Sum of the path costs from left, right, top and bottom."""
    height, width, count = cost.shape
    total = np.zeros_like(cost)
    for way in range(4):
        across = way < 2
        lines, steps = (height, width) if across else (width, height)
        before, now = np.zeros(count, np.float32), np.zeros(count, np.float32)
        for line in range(lines):
            before[:] = 0
            least = np.float32(0)
            for step in range(steps):
                at = step if way % 2 == 0 else steps - 1 - step
                y, x = (line, at) if across else (at, line)
                lowest = np.float32(1e9)
                for k in range(count):
                    best = min(before[k], least + large)
                    if k > 0:
                        best = min(best, before[k - 1] + small)
                    if k < count - 1:
                        best = min(best, before[k + 1] + small)
                    value = cost[y, x, k] + best - least
                    now[k] = value
                    total[y, x, k] += value
                    lowest = min(lowest, value)
                before[:] = now
                least = lowest
    return total


@njit(cache=True)
def _pick(total: Any, low: int, uniqueness: float, difference: int) -> Any:
    """Winner, unique, consistent from the right, refined by two lines; NaN elsewhere."""
    height, width, count = total.shape
    found = np.full((height, width), np.float32(np.nan))
    best = np.zeros(width, np.int64)
    for y in range(height):
        best_right = np.full(width, -1)
        least_right = np.full(width, np.float32(1e9))
        for x in range(width):
            best[x] = np.argmin(total[y, x])
            for k in range(count):
                at = x - low - k
                if 0 <= at < width and total[y, x, k] < least_right[at]:
                    least_right[at], best_right[at] = total[y, x, k], k
        for x in range(width):
            k = best[x]
            at = x - low - k
            if at < 0 or at >= width or k == 0 or k == count - 1:
                continue
            if abs(best_right[at] - k) > difference:
                continue
            lowest, second = total[y, x, k], np.float32(1e9)
            for q in range(count):
                if abs(q - k) > 1:
                    second = min(second, total[y, x, q])
            if lowest > second * (1 - uniqueness):
                continue
            a, b = total[y, x, k - 1], total[y, x, k + 1]
            rise = max(a, b) - lowest
            shift = 0.5 * (a - b) / rise if rise > 0 else 0.0
            found[y, x] = low + k + shift
    return found
