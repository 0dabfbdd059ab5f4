"""What a scanner delivers: a coloured mesh with holes, its provenance, and each unit's part."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera
from synthgen.geometry.transforms import apply
from synthgen.scanner.rectify import Rectified

Level = Literal["full", "half", "model"]


@dataclass(frozen=True, eq=False)
class UnitScan:
    """What one unit measured.

    Attributes
    ----------
    ident : str
    pair : Rectified
        By the nominal calibration, with the cameras themselves.
    left, right : (H, W) uint8 or None
        Rectified pictures; None for level ``model``, which takes none.
    disparity : (h, w) float32
        Pixels of the rectified pictures, NaN where unmatched; sample (r, c) is pixel
        ``(x, y) = (step * c, step * r)`` of the left picture.
    step : int
    true_disparity : (h, w) float32 or None
        What an ideal matcher would have found on the same grid, NaN where the surface is not seen
        by both cameras; where it was asked for.
    problem : str or None
        Why the unit gave nothing, or what is doubtful about it.
    """

    ident: str
    pair: Rectified
    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    disparity: NDArray[np.float32]
    step: int
    true_disparity: NDArray[np.float32] | None = None
    problem: str | None = None

    @property
    def Q(self) -> NDArray[np.float64]:
        """(4, 4): from (x, y, disparity, 1) to the homogeneous point in the pair's frame."""
        return self.pair.Q


@dataclass(frozen=True, eq=False)
class Scan:
    """One scan, in the rig's frame, metres.

    Attributes
    ----------
    vertices, normals : (V, 3) float32
    faces : (F, 3) int32
        Counter-clockwise seen from outside; real holes are left open.
    colors : (V, 3) uint8
        sRGB; grey 128 where no colour camera sees the vertex.
    uv : (V, 2) float32
        Where ``texture`` has the vertex's own colour; origin bottom left.
    corner_uv : (F, 3, 2) float32
        Texture coordinates to draw faces with: all corners in the picture of one camera.
    texture : (H, W, 3) uint8
    provenance : dict of (V,) arrays
        ``unit`` index into ``units`` (-1 in a hole that was filled), ``confidence`` correlation
        0..1, ``sigma_m`` standard error of its depth (NaN in a filled hole), ``colour_unit`` index
        into ``units`` (-1 unseen); and where truth was asked for: ``solid``, ``face``,
        ``barycentric`` (V, 3) on the true surface and ``error_m``, signed, positive outside.
    units : tuple of UnitScan
    level : {"full", "half", "model"}
    problem : str or None
        Why the scan is empty; None where it is not.
    report : dict
        JSON types: what every unit did and lost, and ``notes`` on what was not as asked; see
        :func:`synthgen.scanner.report.scan_report`.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32]
    colors: NDArray[np.uint8]
    uv: NDArray[np.float32]
    corner_uv: NDArray[np.float32]
    texture: NDArray[np.uint8]
    provenance: dict[str, NDArray[Any]]
    units: tuple[UnitScan, ...] = ()
    level: Level = "full"
    problem: str | None = field(default=None)
    report: dict[str, Any] = field(default_factory=dict)

    def moved(self, transform: NDArray[Any]) -> Scan:
        """Return the scan after a rigid ``T_dst_from_src`` (4, 4), calibrations included."""
        T = np.asarray(transform, np.float64)
        return replace(
            self,
            vertices=apply(T, self.vertices).astype(np.float32),
            normals=(self.normals @ T[:3, :3].T).astype(np.float32),
            units=tuple(replace(u, pair=_moved_pair(u.pair, T)) for u in self.units),
        )

    def keep(self, vertices: NDArray[np.bool_]) -> Scan:
        """Return the scan with only some vertices (V,) and the faces between them."""
        faces = self.faces[vertices[self.faces].all(axis=1)]
        row = np.cumsum(vertices) - 1
        return replace(
            self,
            vertices=self.vertices[vertices],
            normals=self.normals[vertices],
            faces=row[faces].astype(np.int32),
            colors=self.colors[vertices],
            uv=self.uv[vertices],
            corner_uv=self.corner_uv[vertices[self.faces].all(axis=1)],
            provenance={name: values[vertices] for name, values in self.provenance.items()},
        )


def _moved_pair(pair: Rectified, T: NDArray[np.float64]) -> Rectified:
    def move(camera: Camera) -> Camera:
        rows = tuple(tuple(float(v) for v in row) for row in T @ camera.T)
        return replace(camera, T_world_from_camera=rows)

    left, right, view = move(pair.left), move(pair.right), move(pair.camera)
    return replace(pair, left=left, right=right, camera=view)


def empty_scan(units: tuple[UnitScan, ...], level: Level, problem: str) -> Scan:
    """Return a scan without vertices that says why."""
    return Scan(
        vertices=np.zeros((0, 3), np.float32),
        normals=np.zeros((0, 3), np.float32),
        faces=np.zeros((0, 3), np.int32),
        colors=np.zeros((0, 3), np.uint8),
        uv=np.zeros((0, 2), np.float32),
        corner_uv=np.zeros((0, 3, 2), np.float32),
        texture=np.full((8, 8, 3), 128, np.uint8),
        provenance={},
        units=units,
        level=level,
        problem=problem,
    )
