"""Reading scans from files, with units guessed from the extent and said."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.normals import vertex_normals
from synthgen.registration.inspection import HAND, UNITS, Expected, extent, units_of
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
MESH_FORMATS, TEXT_FORMATS = (".ply", ".obj", ".glb", ".gltf", ".stl", ".off"), (".xyz", ".txt")
# Coarse meshes are sampled on their faces; those with this share of the points wanted are fine
# enough to be taken at their vertices.
FINE = 0.4
# Three more numbers beside a point are a normal if they are that near to unit length; or a colour.
UNIT = 0.05


@dataclass(frozen=True, eq=False)
class StoredScan:
    """A scan from a file.

    Attributes
    ----------
    points : (N, 3) float64, metres where ``units`` is known
    normals : (N, 3) or None
    units : str
        Of the file: "m", "mm", "cm", "inch"; "" if unknown.
    note : str
        What was guessed, for the user.
    """

    points: Array
    normals: Array | None
    units: str
    note: str


def read_scan(path: Path, units: str = "auto", expected: Expected = HAND) -> StoredScan:
    """Read PLY, OBJ, GLB (meshes or points) or XYZ text (x y z, optionally unit normals).

    Parameters
    ----------
    path : Path
    units : "auto" or a unit
        Auto: the one unit in which the points would have the size of what is expected.
    expected : Expected
        A hand or a body (:func:`synthgen.registration.inspection.expected_of`).

    Raises
    ------
    ShapeError
        If the file cannot be read as points, or the unit is unknown.
    """
    if units != "auto" and units not in UNITS:
        raise ShapeError(f"units={units!r}; expected auto, {', '.join(UNITS)}")
    if not path.is_file():
        raise ShapeError(f"{path}: no such file")
    kind = path.suffix.lower()
    if kind not in MESH_FORMATS + TEXT_FORMATS:
        known = " ".join(MESH_FORMATS + TEXT_FORMATS)
        raise ShapeError(f"{path}: unknown kind of file {kind!r}; known: {known}")
    try:
        points, normals = _text(path) if kind in TEXT_FORMATS else _mesh(path, expected.points)
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OSError) as error:
        raise ShapeError(f"{path}: cannot be read as points: {error}") from error
    return _scaled(points, normals, units, expected)


def _scaled(points: Array, normals: Array | None, units: str, expected: Expected) -> StoredScan:
    finite = points[np.isfinite(points).all(axis=1)]
    if units != "auto":
        return StoredScan(points * UNITS[units], normals, units, f"units: {units}, as given")
    if len(finite) < 20:
        return StoredScan(points, normals, "", "too few points to tell units")
    size, found = extent(finite), units_of(finite, expected)
    if "m" in found:
        return StoredScan(points, normals, "m", f"units: m ({size:.3f} m across)")
    if len(found) == 1:
        factor = UNITS[found[0]]
        note = f"units: {found[0]} ({size:.4g} across; converted to {size * factor:.3f} m)"
        return StoredScan(points * factor, normals, found[0], note)
    choice = (
        f"could be {' or '.join(found)}" if found else f"no usual unit makes it a {expected.noun}"
    )
    return StoredScan(points, normals, "", f"{size:.4g} across: {choice}; taken as metres")


def _text(path: Path) -> tuple[Array, Array | None]:
    lines = path.read_text(encoding="utf-8").replace(",", " ").splitlines()
    rows = [line.split() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        return np.zeros((0, 3)), None
    table = np.array([[float(word) for word in row] for row in rows], dtype=np.float64)
    if table.ndim != 2 or table.shape[1] < 3:
        raise ValueError(f"rows of {table.shape[-1]} numbers; expected x y z [nx ny nz]")
    normals = table[:, 3:6] if table.shape[1] == 6 else None
    if normals is not None and not _are_unit(normals):
        normals = None  # colours
    return table[:, :3], normals


def _are_unit(vectors: Array) -> bool:
    length = np.linalg.norm(vectors, axis=1)
    known = length[np.isfinite(length) & (length > 0)]
    return len(known) > 0 and bool((np.abs(known - 1) < UNIT).mean() > 0.9)


def _mesh(path: Path, wanted: int) -> tuple[Array, Array | None]:
    import trimesh

    loaded: Any = trimesh.load(path, process=False)
    if isinstance(loaded, trimesh.Scene):
        parts = [g for g in loaded.dump() if hasattr(g, "vertices")]
        if not parts:
            return np.zeros((0, 3)), None
        meshes = [p for p in parts if isinstance(p, trimesh.Trimesh)]
        loaded = trimesh.util.concatenate(meshes) if meshes else parts[0]
    points = np.asarray(loaded.vertices, dtype=np.float64)
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        return points, _ply_normals(loaded)
    faces = np.asarray(loaded.faces, dtype=np.int64)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    faces = faces[finite[faces].all(axis=1)]
    safe = np.where(finite[:, None], points, 0)
    normals = vertex_normals(safe, faces)
    if len(points) >= FINE * wanted:
        used = np.unique(faces)
        return points[used], normals[used]
    return _sampled(safe, faces, normals, wanted)


def _sampled(
    points: Array, faces: NDArray[np.int64], normals: Array, n: int
) -> tuple[Array, Array]:
    rng = stream(0, "corpus", 0, 0, "surface samples")
    corners = points[faces]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(u, v), axis=1)
    if area.sum() <= 0:
        return points, normals
    chosen = rng.choice(len(faces), size=n, p=area / area.sum())
    b = rng.dirichlet([1.0, 1.0, 1.0], n)
    at = np.einsum("nk,nka->na", b, corners[chosen])
    return at, np.einsum("nk,nka->na", b, normals[faces[chosen]])


def _ply_normals(cloud: Any) -> Array | None:
    raw = getattr(cloud, "metadata", {}).get("_ply_raw", {}).get("vertex", {}).get("data")
    names = getattr(getattr(raw, "dtype", None), "names", None) or ()
    if raw is None or not {"nx", "ny", "nz"} <= set(names):
        return None
    return np.stack([np.asarray(raw[k], dtype=np.float64).ravel() for k in ("nx", "ny", "nz")], 1)
