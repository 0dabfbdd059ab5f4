"""Cutting a scan as the paper does: the arm and the stand by a plane, green objects by colour.

Embodied Hands, section 3.1: a vertex belongs to an object if G > max(R, 20) in 8-bit RGB; what is
removed leaves holes.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.normals import unit
from synthgen.scanner.result import Scan

DARKEST_GREEN = 20


@dataclass(frozen=True)
class CropPlane:
    """Keeps what lies on the side that ``normal`` points to.

    Attributes
    ----------
    point_m, normal : tuple of float
        A point on the plane and its direction, rig frame; the normal need not be a unit vector.
    """

    point_m: tuple[float, float, float]
    normal: tuple[float, float, float]

    def keeps(self, points: NDArray[Any]) -> NDArray[np.bool_]:
        """Tell which points (n, 3) stay."""
        return np.asarray(self.side(points) >= 0)

    def side(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Return the distances (n,) of points (n, 3) from the plane, positive where kept."""
        direction = unit(np.array(self.normal, np.float64))
        if not np.any(direction):
            raise ShapeError(f"the crop plane's normal {self.normal} has no direction")
        return np.asarray((np.asarray(points) - np.array(self.point_m)) @ direction)


def wrist_plane(joints: NDArray[Any], beyond_m: float = 0.0) -> CropPlane:
    """Return the plane through the wrist, joint 0 of a hand (K, 3), that keeps the fingers' side.

    ``beyond_m`` moves it towards the arm.
    """
    wrist, knuckles = joints[0], np.mean(joints[[1, 4, 7, 10]], axis=0)
    along = unit(np.asarray(knuckles - wrist, np.float64))
    point = wrist - beyond_m * along
    (px, py, pz), (nx, ny, nz) = point.tolist(), along.tolist()
    return CropPlane((px, py, pz), (nx, ny, nz))


def is_green(colors: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which 8-bit sRGB colours (..., 3) count as object: G > max(R, 20)."""
    red, green = colors[..., 0].astype(np.int32), colors[..., 1].astype(np.int32)
    return np.asarray(green > np.maximum(red, DARKEST_GREEN))


def segment(scan: Scan, plane: CropPlane | None = None, objects: bool = True) -> Scan:
    """Return the hand alone.

    Parameters
    ----------
    scan : Scan
    plane : CropPlane, optional
        Where the arm and the stand are cut off; None cuts nothing.
    objects : bool
        Remove green vertices.
    """
    keep = np.ones(len(scan.vertices), dtype=bool)
    if plane is not None:
        keep &= plane.keeps(scan.vertices)
    if objects:
        keep &= ~is_green(scan.colors)
    cut = scan.keep(keep)
    if len(scan.vertices) and not keep.any():
        return dataclasses.replace(
            cut, problem="nothing is left of the scan after cutting plane and green objects"
        )
    return cut
