"""Texels of a hand's atlas as places on its skin in the rest pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from synthgen.geometry.cameras import camera_from_K
from synthgen.geometry.normals import unit
from synthgen.geometry.raster import rasterise
from synthgen.models import ManoModel
from synthgen.scene.anatomy import Anatomy, anatomy_of
from synthgen.scene.surface import DrawnSurface

Values = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Sites:
    """Places on the skin, in the right hand's frame of :mod:`synthgen.scene.anatomy`.

    Attributes
    ----------
    points, normals : (n, 3) float32
        Metres; unit.
    weights : (n, 17) float32
        Skinning weights, the arm's last.
    spacing_m : float
        Typical distance between neighbours: finer detail cannot be held.
    """

    points: Values
    normals: Values
    weights: Values
    spacing_m: float

    def finger_weight(self, finger: int) -> Values:
        """Share (n,) of a finger's three joints in each place's skinning."""
        return np.asarray(self.weights[:, 1 + 3 * finger : 4 + 3 * finger].sum(axis=1))

    def width(self, wanted_m: float) -> float:
        """Return the half width that a line of a wanted one can have here."""
        return max(wanted_m, 0.75 * self.spacing_m)


def atlas_sites(model: ManoModel, size: int) -> tuple[Sites, NDArray[np.int32]]:
    """Rasterise a model's atlas.

    Returns
    -------
    sites : Sites
        The covered texels, in reading order, first row at v = 1.
    fill : (size, size) int32
        For every texel, the covered one that is shown there: itself, or the nearest.
    """
    drawn, anatomy = DrawnSurface.for_model(model), anatomy_of(model)
    flat = np.column_stack([drawn.uv[:, 0], 1 - drawn.uv[:, 1], np.ones(len(drawn.uv))])
    K = np.array([[size, 0, -0.5], [0, size, -0.5], [0, 0, 1]], dtype=np.float64)
    triangles = drawn.triangles.astype(np.int64)
    face, barycentric, _ = rasterise(flat, triangles, camera_from_K(K, size, size))
    covered = face >= 0
    corners = drawn.source[triangles[face[covered]]]
    inside = barycentric[covered].astype(np.float32)
    sites = Sites(
        points=_blend(anatomy.points, corners, inside),
        normals=_blend(anatomy.normals, corners, inside, even=True),
        weights=_blend(anatomy.weights, corners, inside),
        spacing_m=_spacing(anatomy, drawn, size),
    )
    return sites, _fill(covered)


def _blend(
    values: NDArray[np.float64], corners: NDArray[np.int64], inside: Values, even: bool = False
) -> Values:
    """Interpolate vertex values (n, m) at texels; ``even`` scales rows to length 1."""
    narrow = values.astype(np.float32)
    total = inside[:, :1] * narrow[corners[:, 0]]
    for k in (1, 2):
        total += inside[:, k : k + 1] * narrow[corners[:, k]]
    return unit(total.astype(np.float64)).astype(np.float32) if even else np.asarray(total)


def _spacing(anatomy: Anatomy, drawn: DrawnSurface, size: int) -> float:
    """Median length on the hand's skin of one texel."""
    t = drawn.triangles
    edge = anatomy.points[drawn.source[t[:, 0]]] - anatomy.points[drawn.source[t[:, 1]]]
    flat = (drawn.uv[t[:, 0]] - drawn.uv[t[:, 1]]).astype(np.float64)
    hand = anatomy.weights[drawn.source[t[:, 0]], 16] < 0.5
    scale = np.linalg.norm(edge, axis=1) / np.maximum(np.linalg.norm(flat, axis=1), 1e-9)
    return float(np.median(scale[hand])) / size


def _fill(covered: NDArray[np.bool_]) -> NDArray[np.int32]:
    near = ndimage.distance_transform_edt(~covered, return_distances=False, return_indices=True)
    number = np.zeros(covered.shape, dtype=np.int32)
    number[covered] = np.arange(int(covered.sum()), dtype=np.int32)
    return np.asarray(number[near[0], near[1]])
