"""Pictures of a scan for people: speckle pair, disparity, signed error, and the scan itself."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, camera_from_K
from synthgen.geometry.normals import face_cross, unit
from synthgen.geometry.raster import rasterise
from synthgen.geometry.transforms import look_at
from synthgen.scanner import Scan, UnitScan
from synthgen.scanner.colour import sample as look_up

Image = NDArray[np.uint8]
Array = NDArray[np.float64]
ERROR_RANGE_M = 0.0005
_GREY, _SIZE = 40, 420


def scan_pictures(scan: Scan) -> dict[str, Image]:
    """Return what there is of a scan: ``speckle``, ``disparity``, ``error``, ``scan``."""
    found: dict[str, Image] = {}
    unit_ = max(scan.units, key=lambda u: int(np.isfinite(u.disparity).sum()), default=None)
    if unit_ is not None and unit_.left is not None and unit_.right is not None:
        found["speckle"] = speckle_picture(unit_)
    if unit_ is not None:
        found["disparity"] = disparity_picture(unit_)
    face, inside, camera = _drawn(scan, unit_)
    if "error_m" in scan.provenance:
        found["error"] = error_picture(scan, face, inside)
    found["scan"] = textured_picture(scan, face, inside, camera)
    return found


def speckle_picture(unit_: UnitScan) -> Image:
    """Both rectified pictures side by side; a point lies in one row."""
    assert unit_.left is not None
    assert unit_.right is not None
    both = np.concatenate([unit_.left, unit_.right], axis=1)
    return np.repeat(both[..., None], 3, axis=2)


def disparity_picture(unit_: UnitScan) -> Image:
    """Disparities, near is bright; what was not matched is dark."""
    known = np.isfinite(unit_.disparity)
    low, high = np.quantile(unit_.disparity[known], [0.01, 0.99]) if known.any() else (0.0, 1.0)
    share = (np.nan_to_num(unit_.disparity) - low) / max(high - low, 1e-6)
    return _coloured(share, known, cv2.COLORMAP_VIRIDIS)


def error_picture(scan: Scan, face: NDArray[np.int32], inside: Array) -> Image:
    """Signed error of the drawn scan, blue inside, red outside, full at half a millimetre."""
    hit = face >= 0
    error = np.zeros(face.shape)
    error[hit] = np.einsum(
        "nk,nk->n", scan.provenance["error_m"][scan.faces[face[hit]]], inside[hit]
    )
    return _coloured(error / (2 * ERROR_RANGE_M) + 0.5, hit, cv2.COLORMAP_TURBO)


def textured_picture(scan: Scan, face: NDArray[np.int32], inside: Array, camera: Camera) -> Image:
    """Draw the scan with its texture, lit from the eye; through holes its inside shows in red."""
    hit = face >= 0
    corners = scan.vertices[scan.faces].astype(np.float64)
    normal = unit(face_cross(scan.vertices, scan.faces))
    shade = np.einsum("fk,fk->f", normal, unit(camera.position - corners.mean(axis=1)))[face[hit]]
    height, width = scan.texture.shape[:2]
    uv = np.einsum("nkj,nk->nj", scan.corner_uv[face[hit]].astype(np.float64), inside[hit])
    colour = look_up(scan.texture, uv * [width, -height] + [0, height] - 0.5) / 255.0
    colour = np.where(shade[:, None] > 0, colour, [0.55, 0.12, 0.1])
    picture = np.full((*face.shape, 3), _GREY, np.uint8)
    light = 0.35 + 0.65 * np.abs(shade)[:, None]
    picture[hit] = np.clip(255 * colour * light, 0, 255).astype(np.uint8)
    return picture


def _drawn(scan: Scan, unit_: UnitScan | None) -> tuple[NDArray[np.int32], Array, Camera]:
    """Rasterise the scan as a unit sees it, filling the picture; from +z without one."""
    middle = (scan.vertices.min(axis=0) + scan.vertices.max(axis=0)).astype(np.float64) / 2
    reach = float(np.linalg.norm(scan.vertices - middle, axis=1).max())
    eye, up = middle + np.array([0.0, 0.0, 4 * reach]), (0.0, 1.0, 0.0)
    if unit_ is not None:
        T = unit_.pair.camera.T
        eye, up = T[:3, 3], tuple(-T[:3, 1])
    distance = float(np.linalg.norm(eye - middle))
    f = 0.48 * _SIZE * np.sqrt(max(distance**2 - reach**2, 1e-6)) / reach
    K = np.array([[f, 0, (_SIZE - 1) / 2], [0, f, (_SIZE - 1) / 2], [0, 0, 1]])
    camera = camera_from_K(K, _SIZE, _SIZE, look_at(eye, middle, up))
    face, inside, _ = rasterise(scan.vertices, scan.faces, camera)
    return face, inside, camera


def _coloured(share: NDArray[np.float64], known: NDArray[np.bool_], table: int) -> Image:
    index = (255 * np.clip(share, 0, 1)).astype(np.uint8)
    picture = cv2.applyColorMap(index, table)[..., ::-1].copy()
    picture[~known] = _GREY
    return np.asarray(picture, np.uint8)
