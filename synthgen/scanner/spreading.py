"""What a sample's neighbours say about it: a check on what was matched, a start where it was not.

A refined sample knows its disparity and its slope, so each neighbour predicts it. Where the
prediction disagrees the match is wrong; where there is none it is a better start than any seed
(reliability-guided correlation, Pan 2009, in a few sweeps instead of a queue).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Grid = NDArray[np.float32]
_AROUND = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]


def predicted(
    disparity: Grid, slope: Grid, step: int, where: NDArray[np.bool_]
) -> tuple[Grid, Grid, NDArray[np.int64]]:
    """Predict samples from their eight neighbours.

    Parameters
    ----------
    disparity : (h, w) float32
        Pixels, NaN where unknown.
    slope : (h, w, 2) float32
        Its derivatives along x and y.
    step : int
        Pixels between samples.
    where : (h, w) bool
        The n samples that are asked for.

    Returns
    -------
    disparity : (n,) float32
        Median of the predictions, NaN without any.
    slope : (n, 2) float32
        That of the neighbour whose prediction it is.
    count : (n,) int
        Known neighbours.
    """
    rows, columns = np.nonzero(where)
    values = _padded(disparity)
    tilts = [_padded(slope[..., k]) for k in (0, 1)]
    guesses = np.empty((len(_AROUND), len(rows)), np.float32)
    leans = np.empty((2, len(_AROUND), len(rows)), np.float32)
    for k, (j, i) in enumerate(_AROUND):
        at = rows + 1 + j, columns + 1 + i
        leans[:, k] = [tilt[at] for tilt in tilts]
        guesses[k] = values[at] - step * (i * leans[0, k] + j * leans[1, k])
    order = np.argsort(guesses, axis=0)  # NaN comes last
    count = np.isfinite(guesses).sum(axis=0)
    middle = order[np.maximum(count - 1, 0) // 2, np.arange(len(rows))]
    picked = middle, np.arange(len(rows))
    return guesses[picked], np.stack([lean[picked] for lean in leans], axis=1), count


def _padded(values: NDArray[Any]) -> NDArray[Any]:
    return np.pad(values, 1, constant_values=np.nan)
