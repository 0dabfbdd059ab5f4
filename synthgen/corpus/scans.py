"""Scans in a corpus: encoding into the members of the columns scan and stereo, and back.

==========  =========================  =====================================================
column      member                     content
==========  =========================  =====================================================
scan        KEY.scan.ply               mesh, world of the sample, metres: normals, colours,
                                       texture coordinates, and the provenance per vertex
..          KEY.texture.jpg            texture map, sRGB
..          KEY.corner_uv.npy          (F, 3, 2) uint16 / 65535, per corner of each face
..          KEY.scan.json              rig, level, scanner seed, pose, and the report: what every
                                       unit did and lost, what was not as asked
stereo      KEY.UNIT.left.png, right   rectified speckle pictures, 8 bit
..          KEY.UNIT.disparity.npy     measured, (h, w) float32 pixels, NaN unknown
..          KEY.UNIT.true.npy          what an ideal matcher would find, the same grid
..          KEY.UNIT.json              Q, cameras, step of the grid, what is wrong
==========  =========================  =====================================================
"""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.corpus.columns import Members, decode_image, png
from synthgen.errors import IntegrityError
from synthgen.geometry.cameras import Camera
from synthgen.scanner import Rig, Scan, UnitScan
from synthgen.scanner.files import ply_bytes, read_ply
from synthgen.scanner.rectify import Rectified

JPEG_QUALITY = 92
Fetch = Callable[[str, str], bytes]


def scan_members(scan: Scan, rig: Rig, T_world_from_rig: NDArray[Any]) -> Members:
    """Encode the mesh; the same scan gives the same bytes."""
    facts = {
        "rig": rig.name,
        "scanner_seed": rig.seed,
        "level": scan.level,
        "T_world_from_rig": np.asarray(T_world_from_rig).tolist(),
        "units": [{"ident": unit.ident, "problem": unit.problem} for unit in scan.units],
        "report": scan.report,
    }
    bgr = np.ascontiguousarray(scan.texture[..., ::-1])
    picture = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return {
        "scan.ply": ply_bytes(scan),
        "texture.jpg": picture.tobytes(),
        "corner_uv.npy": npy(np.rint(scan.corner_uv * 65535).astype(np.uint16)),
        "scan.json": _json(facts),
    }


def stereo_members(scan: Scan) -> Members:
    """Encode every unit's pictures, disparities and calibration."""
    found: Members = {}
    for unit in scan.units:
        assert unit.left is not None
        assert unit.right is not None
        found[f"{unit.ident}.left.png"] = png(unit.left)
        found[f"{unit.ident}.right.png"] = png(unit.right)
        found[f"{unit.ident}.disparity.npy"] = npy(unit.disparity)
        if unit.true_disparity is not None:
            found[f"{unit.ident}.true.npy"] = npy(unit.true_disparity)
        found[f"{unit.ident}.json"] = _json(_calibration(unit))
    return found


def _calibration(unit: UnitScan) -> dict[str, Any]:
    pair = unit.pair
    return {
        "Q": unit.Q.tolist(),
        "left": dataclasses.asdict(pair.left),
        "right": dataclasses.asdict(pair.right),
        "rectified": dataclasses.asdict(pair.camera),
        "cx_right": pair.cx_right,
        "baseline_m": pair.baseline_m,
        "step": unit.step,
        "problem": unit.problem,
    }


def read_scan(key: str, fetch: Fetch) -> Scan | None:
    """Read the scan of a sample, None where the corpus has none.

    Raises
    ------
    IntegrityError
        If what is stored is damaged.
    """
    try:
        data = fetch("scan", f"{key}.scan.ply")
    except KeyError:
        return None
    vertices, faces = read_ply(data, f"{key}.scan.ply")
    facts = json.loads(fetch("scan", f"{key}.scan.json"))
    uv = read_npy(fetch("scan", f"{key}.corner_uv.npy"), f"{key}.corner_uv.npy")
    return Scan(
        vertices=np.stack([vertices.pop(k) for k in "xyz"], axis=1),
        normals=np.stack([vertices.pop(k) for k in ("nx", "ny", "nz")], axis=1),
        faces=faces,
        colors=np.stack([vertices.pop(k) for k in ("red", "green", "blue")], axis=1),
        uv=np.stack([vertices.pop(k) for k in ("atlas_u", "atlas_v")], axis=1),
        corner_uv=(uv / 65535).astype(np.float32),
        texture=np.ascontiguousarray(
            decode_image(fetch("scan", f"{key}.texture.jpg"), f"{key}.texture.jpg", 3)
        ),
        provenance=_provenance(vertices),
        units=tuple(u for row in facts["units"] if (u := _unit(key, row["ident"], fetch))),
        level=facts["level"],
        report=facts.get("report", {}),
    )


def _provenance(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    named = {"confidence" if k == "quality" else k: v for k, v in columns.items()}
    inside = [named.pop(k) for k in ("barycentric_0", "barycentric_1", "barycentric_2")]
    return named | {"barycentric": np.stack(inside, axis=1)}


def _unit(key: str, ident: str, fetch: Fetch) -> UnitScan | None:
    name = f"{key}.{ident}"
    try:
        facts = json.loads(fetch("stereo", f"{name}.json"))
    except KeyError:
        return None
    left, right, view = (_camera(facts[k]) for k in ("left", "right", "rectified"))
    try:
        true = read_npy(fetch("stereo", f"{name}.true.npy"), f"{name}.true.npy")
    except KeyError:
        true = None
    pictures = [decode_image(fetch("stereo", f"{name}.{k}.png"), name) for k in ("left", "right")]
    return UnitScan(
        ident=ident,
        pair=Rectified(left, right, view, facts["cx_right"], facts["baseline_m"]),
        left=pictures[0],
        right=pictures[1],
        disparity=read_npy(fetch("stereo", f"{name}.disparity.npy"), f"{name}.disparity.npy"),
        step=facts["step"],
        true_disparity=true,
        problem=facts["problem"],
    )


def _camera(row: dict[str, Any]) -> Camera:
    rows = tuple(tuple(values) for values in row["T_world_from_camera"])
    k1, k2, p1, p2, k3 = row["distortion"]
    return Camera(**{**row, "distortion": (k1, k2, p1, p2, k3), "T_world_from_camera": rows})


def npy(values: NDArray[Any]) -> bytes:
    """Encode an array as NumPy stores it, without pickles."""
    stream = io.BytesIO()
    np.save(stream, values, allow_pickle=False)
    return stream.getvalue()


def read_npy(data: bytes, what: str) -> NDArray[Any]:
    """Decode what :func:`npy` encodes; ``what`` is its name in the error."""
    try:
        return np.asarray(np.load(io.BytesIO(data), allow_pickle=False))
    except (ValueError, OSError, EOFError) as error:
        raise IntegrityError(f"{what} is damaged ({error})") from None


def _json(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
