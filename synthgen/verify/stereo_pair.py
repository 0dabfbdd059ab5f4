"""One unit's part of a scan, with what is known of it beside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.scanner import UnitScan
from synthgen.scanner.rig import Glass, Unit

Array = NDArray[np.float64]
FEWEST = 150  # samples of a unit's grid, to tell anything of it


@dataclass(frozen=True, eq=False)
class Pair:
    """One unit's rectified pair, in the rig's frame.

    Attributes
    ----------
    stored : UnitScan
    Q : (4, 4) float64
        As stored.
    unit : Unit or None
        The rig's own; None where the rig is not known, for the reason ``unknown``.
    unknown : str
    glass : Glass or None
        What the unit may look through.
    vertices, faces : (V, 3) float64, (F, 3) int64
        The true surface, where it was when the unit exposed.
    scan : cKDTree
        Of the scan's vertices.
    """

    stored: UnitScan
    Q: Array
    unit: Unit | None
    unknown: str
    glass: Glass | None
    vertices: Array
    faces: NDArray[np.int64]
    scan: cKDTree
