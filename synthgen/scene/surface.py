"""The drawn surface of a hand: smooth, through the model's vertices, with its bookkeeping.

What is rendered is what is labelled: every drawn triangle knows its parent face in the model and
the barycentric coordinates of its corners there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from synthgen.geometry.normals import face_cross, incidence, unit
from synthgen.geometry.subdivision import InterpolatingSubdivision
from synthgen.models import HandSurface, ManoModel

Array = NDArray[np.float64]
LEVELS = 2


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """Refinement of one hand-and-arm topology into render vertices.

    Attributes
    ----------
    triangles : (Fd, 3) uint32
        Into the render vertices, which are split along texture seams.
    uv : (Vd, 2) float32
        Origin bottom left.
    source : (Vd,) int64
        Refined (unsplit) vertex of each render vertex.
    """

    surface: HandSurface
    triangles: NDArray[np.uint32]
    uv: NDArray[np.float32]
    source: NDArray[np.int64]
    _refine: InterpolatingSubdivision
    _gather: sparse.csr_matrix

    @staticmethod
    def for_model(model: ManoModel) -> DrawnSurface:
        """Return the drawn surface of a model, built once per model and process."""
        return _build(model)

    def refine(self, surface_vertices: NDArray[Any], relief: Array | None = None) -> Array:
        """Refine surface vertices (S, 3) into unsplit drawn vertices (n, 3), float64.

        ``relief`` (n,) moves each along its normal, metres (:mod:`synthgen.scene.relief`).
        """
        smooth = self._refine.apply(surface_vertices)
        return smooth if relief is None else smooth + relief[:, None] * self._normals(smooth)

    def spread(self, values: NDArray[Any]) -> Array:
        """Carry attributes (S, m) of surface vertices over to the unsplit drawn ones, flat."""
        return np.asarray(self._refine.linear @ values)

    def _normals(self, vertices: Array) -> Array:
        return unit(self._gather @ face_cross(vertices, self._refine.faces))

    @property
    def refined_faces(self) -> NDArray[np.int64]:
        """Drawn triangles (Fd, 3) into the unsplit vertices; rows as ``triangles``."""
        return self._refine.faces

    def draw(
        self, surface_vertices: NDArray[Any], relief: Array | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return render vertices and unit normals, (Vd, 3) float32 each, world, metres.

        ``relief`` as in :meth:`refine`.
        """
        vertices = self.refine(surface_vertices, relief)
        normals = self._normals(vertices)
        return vertices[self.source].astype(np.float32), normals[self.source].astype(np.float32)

    def parent(
        self, prim: NDArray[Any], barycentric: NDArray[Any]
    ) -> tuple[NDArray[np.int32], Array]:
        """Map hits on drawn triangles to the model's faces.

        Parameters
        ----------
        prim : (n,) int
            Drawn triangles.
        barycentric : (n, 3) float
            Weights of their corners.

        Returns
        -------
        face : (n,) int32
            Rows of ``surface.faces`` (the hand's faces come first).
        barycentric : (n, 3) float64
        """
        children = 4**LEVELS
        corners = self._refine.corner_barycentrics[prim % children]
        inside = np.einsum("ni,nij->nj", np.asarray(barycentric, np.float64), corners)
        return (prim // children).astype(np.int32), inside

    def part(self, face: NDArray[Any], barycentric: NDArray[Any]) -> NDArray[np.uint8]:
        """Return part ids of points on the model's faces: the part of the nearest corner."""
        nearest = np.asarray(barycentric).argmax(axis=1)
        return np.asarray(self.surface.part_of_vertex[self.surface.faces[face, nearest]])

    def texture(self, face: NDArray[Any], barycentric: NDArray[Any]) -> NDArray[np.float32]:
        """Return texture coordinates (n, 2) of points on the model's faces."""
        corners = self.surface.uv[self.surface.uv_faces[face]]
        return np.asarray(np.einsum("ni,nij->nj", barycentric, corners), dtype=np.float32)


@lru_cache(maxsize=8)
def _build(model: ManoModel) -> DrawnSurface:
    surface = model.surface
    n_surface = len(surface.part_of_vertex)
    refine = InterpolatingSubdivision.build(surface.faces, n_surface, LEVELS)
    texture = InterpolatingSubdivision.build(surface.uv_faces, len(surface.uv), LEVELS)
    uv = texture.linear @ surface.uv
    pairs = refine.faces.astype(np.int64) * len(uv) + texture.faces
    unique, inverse = np.unique(pairs, return_inverse=True)
    return DrawnSurface(
        surface=surface,
        triangles=inverse.reshape(-1, 3).astype(np.uint32),
        uv=uv[unique % len(uv)].astype(np.float32),
        source=unique // len(uv),
        _refine=refine,
        _gather=incidence(refine.faces, refine.matrix.shape[0]),
    )
