"""Digital image correlation in plain NumPy: what :mod:`synthgen.scanner.dic` computes, readably.

Around each pixel of the left picture a window is laid. Within it the disparity is a polynomial,
the right picture is the left one warped by it, times a gain, plus an offset. Gauss-Newton finds
all of them together (forward additive; Sutton, Orteu & Schreier 2009). The disparity's gradient is
what buys accuracy: without it a slanted surface is matched three times worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

Array = NDArray[np.float64]
DAMPING, SMALLEST_GAIN, SMALLEST_VARIANCE = 1e-6, 1e-3, 1e-6
DRIFT_PX, STEEPEST, SETTLED_PX = 2.0, 0.9, 0.002


@dataclass(frozen=True)
class DicSettings:
    """How pixels are refined.

    Attributes
    ----------
    window : int
        Edge of the window, odd, pixels.
    order : {1, 2}
        Shape function: affine, or quadratic (adds three second derivatives).
    iterations : int
        Most Gauss-Newton steps.
    spread : float
        Standard deviation of the window's Gaussian weight, in half windows.
    """

    window: int = 13
    order: Literal[1, 2] = 1
    iterations: int = 5
    spread: float = 0.6

    @property
    def half(self) -> int:
        """Half the window, pixels, without its centre."""
        return self.window // 2

    @property
    def weights(self) -> Array:
        """(window,) Gaussian along one axis; the window's weight is its outer product."""
        i = np.arange(-self.half, self.half + 1)
        return np.exp(-(i**2) / (2 * (self.spread * self.half) ** 2))

    @property
    def second_moment(self) -> float:
        """Weighted mean of the squared offset along one axis, square pixels."""
        i = np.arange(-self.half, self.half + 1)
        return float((self.weights * i**2).sum() / self.weights.sum())


@dataclass(frozen=True, eq=False)
class Refined:
    """What the refinement found at n pixels; meaningless where ``valid`` is false.

    Attributes
    ----------
    disparity : (n,)
        Pixels.
    slope : (n, 2)
        Its derivatives along x and y.
    correlation : (n,)
        Weighted zero-mean normalised cross-correlation, -1..1.
    sigma : (n,)
        Standard error of the disparity, pixels, from the residuals (sandwich form, both
        pictures' noise included).
    valid : (n,) bool
    """

    disparity: NDArray[Any]
    slope: NDArray[Any]
    correlation: NDArray[Any]
    sigma: NDArray[Any]
    valid: NDArray[np.bool_]


def spline_rows(image: NDArray[Any]) -> NDArray[np.float32]:
    """Cubic B-spline coefficients of each row, zero-mean scale (128 removed), float32.

    A spline through the samples is a far better sub-pixel interpolator than Keys' cubic at the
    same four reads.
    """
    centred = np.asarray(image, np.float32) - np.float32(128)
    return np.asarray(spline_filter1d(centred, 3, axis=1, output=np.float32, mode="mirror"))


def refine_reference(
    left: NDArray[Any],
    right: NDArray[Any],
    xy: NDArray[Any],
    seed: NDArray[Any],
    settings: DicSettings,
    slope: NDArray[Any] | None = None,
) -> Refined:
    """Refine the disparities of pixels one by one.

    Parameters
    ----------
    left, right : (H, W) float
        Rectified, 0..255.
    xy : (n, 2) int
        Pixels of the left picture.
    seed : (n,) float
        Disparities to start from, pixels.
    settings : DicSettings
    slope : (n, 2) float, optional
        Derivatives of the disparity along x and y to start from; default 0.
    """
    coefficients, own = spline_rows(right).astype(np.float64), np.asarray(left, np.float64) - 128
    tilt = np.zeros((len(xy), 2)) if slope is None else np.asarray(slope, np.float64)
    starts = np.column_stack([seed, tilt])
    rows = [
        _one(own, coefficients, int(x), int(y), start, settings)
        for (x, y), start in zip(xy, starts, strict=True)
    ]
    table = np.array(rows).reshape(-1, 6)
    return Refined(table[:, 0], table[:, 1:3], table[:, 3], table[:, 4], table[:, 5] > 0)


def _one(left: Array, right: Array, x: int, y: int, start: Array, s: DicSettings) -> list[float]:
    lost = [np.nan, np.nan, np.nan, -1.0, np.nan, 0.0]
    w = s.half
    height, width = left.shape
    if not (w <= x < width - w and w <= y < height - w):
        return lost
    j, i = np.mgrid[-w : w + 1, -w : w + 1]
    a, b = i / w, j / w
    basis = [np.ones_like(a), a, b, a * a / 2, a * b, b * b / 2][: 3 if s.order == 1 else 6]
    weight = np.outer(s.weights, s.weights)
    patch = left[y - w : y + w + 1, x - w : x + w + 1]
    p = np.zeros(len(basis))
    p[:3] = start * [1, w, w]
    for _ in range(s.iterations):
        warped = _sample(right, x + i - sum(q * f for q, f in zip(p, basis, strict=True)), y + j)
        if warped is None:
            return lost
        value, slope = warped
        columns = np.stack([*(-slope * f for f in basis), value, np.ones_like(a)], axis=-1)
        A = np.einsum("ji,jir,jic->rc", weight, columns, columns)
        r = np.einsum("ji,jir,ji->r", weight, columns, patch)
        total, squares = weight.sum(), (weight * patch**2).sum()
        own = squares - r[-1] ** 2 / total
        other = A[-2, -2] - A[-2, -1] ** 2 / total
        if min(own, other) <= SMALLEST_VARIANCE:
            return lost
        correlation = (r[-2] - A[-2, -1] * r[-1] / total) / np.sqrt(own * other)
        solution = np.linalg.solve(A + DAMPING * np.diag(np.diag(A)), r)
        gain = solution[-2]
        if gain <= SMALLEST_GAIN:
            return lost
        variance = max(squares - solution @ r, 0) / total
        sigma = np.sqrt(variance * (weight**2 * slope**2).sum()) / (gain * A[0, 0])
        step = np.clip(solution[0] / gain, -1, 1)
        p[0] += step
        p[1:] += solution[1:-2] / gain
        if abs(p[0] - start[0]) > DRIFT_PX or max(abs(p[1]), abs(p[2])) > STEEPEST * w:
            return lost
        if abs(step) < SETTLED_PX:
            break
    return [p[0], p[1] / w, p[2] / w, correlation, sigma, 1.0]


def _sample(coefficients: Array, x: Array, y: NDArray[np.int64]) -> tuple[Array, Array] | None:
    """Value and x derivative of the spline rows at (x, y); None beyond the picture."""
    k = np.floor(x).astype(int)
    if k.min() < 1 or k.max() > coefficients.shape[1] - 3:
        return None
    t = x - k
    p0, p1, p2, p3 = (coefficients[y, k + n] for n in (-1, 0, 1, 2))
    c0, c1 = (p0 + 4 * p1 + p2) / 6, (p2 - p0) / 2
    c2, c3 = (p0 - 2 * p1 + p2) / 2, (p3 - p0) / 6 + (p1 - p2) / 2
    return c0 + t * (c1 + t * (c2 + t * c3)), c1 + t * (2 * c2 + 3 * t * c3)
