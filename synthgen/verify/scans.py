"""Checks of a scan's own labels: true errors, faces it lies on, normals, colours and texture.

The witness is libigl's closest point on the hand as the stored truth draws it; of colours and
texture, they themselves.
"""

from __future__ import annotations

from typing import Any

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from synthgen.corpus.sample import Sample
from synthgen.geometry.normals import unit
from synthgen.scanner import Scan
from synthgen.scene.surface import DrawnSurface
from synthgen.verify.report import Record, VerifyReport
from synthgen.verify.stand_in import drawn_hand

Array = NDArray[np.float64]
# Of sound scans all errors are as stored to 3e-7 m, 0.2 % of the faces differ and barycentrics
# agree to 6e-5 (99 %), 0.1 % of the normals face inwards, colours are the texture's to 3 of 255.
# Of depth cameras' scans, which err by millimetres, up to 4.4 % of the normals face inwards, and
# 1.7 % of those within a millimetre of the surface.
ERROR_M, SIDES, OTHER_FACE, BARYCENTRIC = 1e-5, 0.01, 0.03, 0.005
INWARD, NEAR_M, COLOUR = 0.05, 1e-3, 12.0
FEWEST, SKIN_HUE = 150, 1.1


def check_scan(report: VerifyReport, sample: Sample) -> None:
    """Check the labels of a sample's scan; none where it has none or an empty one."""
    if sample.scan is None:
        return
    record = Record(report, sample.index)
    _check_truth(record, sample, sample.scan)
    _check_colours(record, sample, sample.scan)


def _check_truth(record: Record, sample: Sample, scan: Scan) -> None:
    """Compare vertices on the hand, not its arm, with the surface as drawn at the scan's time."""
    names = ("scan error", "scan faces", "scan normals")
    subject, told = sample.subjects[0], scan.provenance
    if "error_m" not in told:
        for name in names:
            record.skip(name, "no true errors are stored")
        return
    own = (told["face"] >= 0) & (told["face"] < len(subject.loaded.faces))
    if own.sum() < FEWEST:
        for name in names:
            record.skip(name, f"fewer than {FEWEST} vertices lie on the hand")
        return
    points, error = scan.vertices[own].astype(np.float64), told["error_m"][own].astype(np.float64)
    vertices, faces = drawn_hand(subject)
    squared, index, foot = igl.point_mesh_squared_distance(points, vertices, faces)[:3]
    corners = vertices[faces[index]]
    outward = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    off = np.abs(np.sqrt(squared) - np.abs(error))
    record.measure("scan error", np.quantile(off, 0.999), ERROR_M,
                   "m between stored errors and those from the true surface (99.9 %)")  # fmt: skip
    side = np.einsum("nk,nk->n", points - foot, outward)
    clear = np.abs(side) > ERROR_M
    record.measure("scan error side", np.mean(clear & (side * error < 0)), SIDES,
                   "share of errors with the wrong sign (positive is outside)")  # fmt: skip
    weights: Any = igl.barycentric_coordinates(
        np.ascontiguousarray(foot), *(np.ascontiguousarray(corners[:, k]) for k in range(3))
    )
    face, inside = DrawnSurface.for_model(subject.loaded).parent(index, weights)
    same = face == told["face"][own]
    record.measure("scan faces", 1 - same.mean(), OTHER_FACE,
                   "share of vertices with another face than the nearest")  # fmt: skip
    if same.any():
        apart = np.abs(inside - told["barycentric"][own])[same]
        record.measure("scan barycentrics", np.quantile(apart, 0.99), BARYCENTRIC,
                       "from the nearest point of the face (99 %)")  # fmt: skip
    near = squared < NEAR_M**2
    if near.sum() < FEWEST:
        record.skip("scan normals", f"fewer than {FEWEST} vertices lie within a millimetre of it")
        return
    inward = np.einsum("nk,nk->n", scan.normals[own], outward)[near] < 0
    record.measure("scan normals", inward.mean(), INWARD,
                   "share of normals that face into the hand")  # fmt: skip


def _check_colours(record: Record, sample: Sample, scan: Scan) -> None:
    """Check that vertices are coloured as the texture is, and like skin."""
    seen = scan.provenance.get("colour_unit", np.full(len(scan.vertices), -1)) >= 0
    if seen.sum() < FEWEST:
        for name in ("scan texture", "scan colours"):
            record.skip(name, f"colour cameras see fewer than {FEWEST} vertices")
        return
    colour = scan.colors[seen].astype(np.float64)
    off = np.abs(_texture_at(scan.texture, scan.uv[seen]) - colour).max(axis=1)
    record.measure("scan texture", np.median(off), COLOUR,
                   "of 255 between vertices and the texture at their uv (median)")  # fmt: skip
    skin = sample.subjects[0].description.skin.dorsal_rgb
    if skin[0] < SKIN_HUE * skin[2]:
        record.skip("scan colours", "the skin has too little hue")
        return
    mean = colour.mean(axis=0)
    record.measure("scan colours", mean[2] - mean[0], 0.0,
                   "skin is bluer than red; channels swapped?")  # fmt: skip


def _texture_at(texture: NDArray[np.uint8], uv: NDArray[Any]) -> Array:
    """Read a texture (H, W, 3) at coordinates (n, 2) with their origin at the bottom left."""
    height, width = texture.shape[:2]
    at = np.stack([(1 - uv[:, 1]) * height, uv[:, 0] * width]).astype(np.float64) - 0.5
    channels = [map_coordinates(texture[..., k].astype(np.float64), at, order=1, mode="nearest")
                for k in range(3)]  # fmt: skip
    return np.stack(channels, axis=1)
