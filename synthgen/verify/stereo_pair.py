"""One unit's part of a scan, with what is known of it beside, and where findings about it go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.scanner import UnitScan
from synthgen.scanner.rig import Glass, Unit
from synthgen.verify.report import VerifyReport

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
        The true surface.
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


@dataclass(frozen=True)
class Record:
    """Where the findings about one unit go."""

    report: VerifyReport
    sample: int
    ident: str

    def measure(self, check: str, value: Any, limit: float, message: str) -> None:
        """Record a measurement of this unit."""
        told = f"unit {self.ident}: {message}"
        self.report.measure(self.sample, -1, check, float(value), limit, told)

    def skip(self, check: str, reason: str) -> None:
        """Record that nothing can be said about this unit."""
        self.report.not_judged(self.sample, -1, check, reason)
