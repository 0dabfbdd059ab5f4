"""Fusion of range grids into a truncated signed distance field, in sparse bricks, with Dr.Jit.

Distances are point-to-plane: from the voxel to the tangent plane of the sample that its projection
falls on. Nothing is carved and nothing is filled: a voxel that no unit observed stays unknown, and
where a cube has an unknown corner there will be no face.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ScanError
from synthgen.render import backend
from synthgen.scanner.range_grid import RangeGrid

BRICK = 8
MOST_VOXELS = 200_000_000
_LEAST_WEIGHT = 0.01
_BRICKS_AT_ONCE, _MOST_ALONG = 8192, 2**20


@dataclass(frozen=True)
class FusionSettings:
    """How range grids become one surface.

    Attributes
    ----------
    voxel_m : float
        Edge of a voxel: about the spacing of the vertices (0.8 mm: 90,000 on a hand).
    truncation : float
        In voxels; 2 to 3. Five nearly doubles the error.
    facing : float
        Surface that no unit sees with both cameras at a larger cosine is cut off: beyond 63
        degrees there is more guessed than measured.
    least_faces : int
        Smaller connected pieces are dropped.
    """

    voxel_m: float = 0.0008
    truncation: float = 3.0
    facing: float = 0.45
    least_faces: int = 200


@dataclass(frozen=True, eq=False)
class Field:
    """A signed distance field in bricks of 8x8x8 voxels; elsewhere nothing was observed.

    Attributes
    ----------
    origin_m : (3,) float64
        Position of voxel (0, 0, 0), rig frame.
    voxel_m : float
    bricks : (n, 3) int64
        Where each stands, in bricks from the origin, in lattice order (x slowest).
    distance_m : (n, 8, 8, 8) float32
        Positive outside; NaN where nothing was observed.
    """

    origin_m: NDArray[np.float64]
    voxel_m: float
    bricks: NDArray[np.int64]
    distance_m: NDArray[np.float32]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along each edge of the box that holds all bricks."""
        x, y, z = (BRICK * (self.bricks.max(axis=0) + 1)).tolist() if len(self.bricks) else [0] * 3
        return x, y, z

    def slab(self, first: int, stop: int) -> NDArray[np.float32]:
        """Return layers first..stop of bricks along x as voxels (8 * layers, ny, nz)."""
        layers, rows, columns = stop - first, self.shape[1] // BRICK, self.shape[2] // BRICK
        dense = np.full((layers, BRICK, rows, BRICK, columns, BRICK), np.nan, np.float32)
        low, high = np.searchsorted(self.bricks[:, 0], [first, stop])
        i, j, k = self.bricks[low:high].T
        dense[i - first, :, j, :, k, :] = self.distance_m[low:high]
        return dense.reshape(layers * BRICK, rows * BRICK, columns * BRICK)


def fuse(grids: Sequence[RangeGrid], settings: FusionSettings) -> Field:
    """Average the units' signed distances, weighted by how squarely each one looks.

    Within a unit's view nearer samples count more, by the square of the distance; units that stand
    further away count no less than others.

    Raises
    ------
    ScanError
        If no grid has a point, or the bricks around the points hold more than 200 million voxels.
    """
    points = [grid.world_points() for grid in grids]
    if not sum(map(len, points)):
        raise ScanError("the scan is empty: no unit measured a point; see each unit's `problem`")
    edge = BRICK * settings.voxel_m
    reach = settings.truncation * settings.voxel_m
    low = np.min([p.min(axis=0) for p in points if len(p)], axis=0) - reach
    first = np.floor(low / edge)  # a fixed lattice: equal scans give equal voxels
    origin = first * edge
    bricks = _touched(points, origin, edge, reach)
    _, rows, columns = bricks.max(axis=0) + 1.0
    # Near the surface, or in the two layers of bricks that are taken out at once.
    voxels = BRICK**3 * max(float(len(bricks)), 2 * rows * columns)
    if voxels > MOST_VOXELS:
        raise ScanError(
            f"{settings.voxel_m} m voxels: {voxels:.3g} of them lie near the measured surface, at "
            f"most {MOST_VOXELS:.0g} fit; use a larger voxel"
        )
    parts = [
        _integrate(grids, bricks[k : k + _BRICKS_AT_ONCE], origin, settings)
        for k in range(0, len(bricks), _BRICKS_AT_ONCE)
    ]
    return Field(origin, settings.voxel_m, bricks, np.concatenate(parts))


def _touched(
    points: list[NDArray[Any]], origin: NDArray[Any], edge: float, reach: float
) -> NDArray[np.int64]:
    """Bricks (n, 3) within reach of a point, in lattice order."""
    keys = []
    steps = max(1, int(np.ceil(2 * reach / edge)))  # none longer than a brick
    for own in points:
        for corner in np.ndindex(*[steps + 1] * 3):
            at = np.floor((own + (2 * np.array(corner) / steps - 1) * reach - origin) / edge)
            i, j, k = np.clip(at.astype(np.int64), 0, _MOST_ALONG - 1).T
            keys.append(np.unique((i * _MOST_ALONG + j) * _MOST_ALONG + k))
    key = np.unique(np.concatenate(keys))
    return np.stack([key // _MOST_ALONG**2, key // _MOST_ALONG % _MOST_ALONG, key % _MOST_ALONG], 1)


def _integrate(
    grids: Sequence[RangeGrid],
    bricks: NDArray[np.int64],
    origin: NDArray[np.float64],
    settings: FusionSettings,
) -> NDArray[np.float32]:
    """Distances (n, 8, 8, 8) of the bricks' voxels, metres, NaN where unobserved."""
    backend.activate()
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()
    lane = dr.arange(mi.UInt32, len(bricks) * BRICK**3)
    brick = lane // BRICK**3
    within = (lane // BRICK**2) % BRICK, (lane // BRICK) % BRICK, lane % BRICK
    corner = [mi.Float(bricks[:, axis].astype(np.float32) * BRICK) for axis in range(3)]
    place = [
        (dr.gather(mi.Float, corner[a], brick) + mi.Float(within[a]))
        * dr.opaque(mi.Float, settings.voxel_m)
        for a in range(3)
    ]
    dr.eval(place)
    total, weight = dr.zeros(mi.Float, dr.width(lane)), dr.zeros(mi.Float, dr.width(lane))
    reach = dr.opaque(mi.Float, settings.truncation * settings.voxel_m)
    for grid in grids:
        if grid.known.any():
            distance, share = _observe(grid, place, origin, reach)
            total, weight = total + share * distance, weight + share
            dr.eval(total, weight)
    mean = np.array(total) / np.maximum(np.array(weight), 1e-9)
    mean[np.array(weight) <= _LEAST_WEIGHT] = np.nan
    return np.asarray(mean.reshape(-1, BRICK, BRICK, BRICK), np.float32)


def _observe(
    grid: RangeGrid, place: list[Any], origin: NDArray[np.float64], reach: Any
) -> tuple[Any, Any]:
    """Point-to-plane distance and weight of every voxel seen by one unit."""
    mi: Any = backend.mitsuba()
    dr: Any = backend.drjit()

    def opaque(value: float) -> Any:
        return dr.opaque(mi.Float, float(value))

    camera = grid.camera
    R = camera.T[:3, :3]
    start = (origin - camera.position) @ R  # float64 here, small numbers on the lanes
    q = [
        sum((place[a] * opaque(R[a, k]) for a in range(3)), start=opaque(start[k]))
        for k in range(3)
    ]
    rows, columns = grid.depth_z_m.shape
    step = opaque(grid.step)
    u = dr.round((opaque(camera.fx) * q[0] / q[2] + opaque(camera.cx)) / step)
    v = dr.round((opaque(camera.fy) * q[1] / q[2] + opaque(camera.cy)) / step)
    seen = (q[2] > 0) & (u >= 0) & (v >= 0) & (u < opaque(columns)) & (v < opaque(rows))
    index = mi.UInt32(dr.select(seen, v * opaque(columns) + u, 0))

    def gathered(values: NDArray[Any]) -> Any:
        table = mi.Float(np.nan_to_num(values).astype(np.float32).ravel())
        return dr.gather(mi.Float, table, index, seen)

    point = [gathered(grid.points[..., k]) for k in range(3)]
    normal = [gathered(grid.normals[..., k]) for k in range(3)]
    z = point[2]
    away = [q[k] - point[k] for k in range(3)]
    distance = sum((normal[k] * away[k] for k in range(3)), start=mi.Float(0))
    # The line of sight must not have left the sample's neighbourhood either.
    seen &= (z > 0) & (dr.abs(distance) <= reach) & (dr.abs(away[2]) <= 3 * reach)
    share = gathered(grid.facing * grid.trust) * dr.square(
        opaque(np.nanmedian(grid.depth_z_m)) / dr.maximum(z, 1e-3)
    )
    behind = dr.select(distance < 0, dr.maximum(1 + distance / reach, 0), 1)
    return distance, dr.select(seen, share * behind, 0)
