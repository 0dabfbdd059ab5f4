"""Reading scans from files, with units guessed from the extent and said."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.normals import vertex_normals
from synthgen.registration.inspection import HAND, UNITS, Expected, extent, units_of
from synthgen.registration.scan import are_positions
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
MESH_FORMATS, TEXT_FORMATS = (".ply", ".obj", ".glb", ".gltf", ".stl", ".off"), (".xyz", ".txt")
# Coarse meshes are sampled on their faces; those with this share of the points wanted are fine
# enough to be taken at their vertices.
FINE = 0.4
# Steps of float32 far from the origin: said from here on, and refused.
NOTED_M, COARSE_M = 1e-4, 2e-3
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
    kind = check_file(path, units)
    try:
        read = _text(path) if kind in TEXT_FORMATS else _mesh(path, expected.points)
    except Exception as error:  # parsers of foreign formats raise anything
        why = f"it lacks {error}" if isinstance(error, KeyError) else error
        raise ShapeError(f"{path}: cannot be read as points: {why}") from error
    scan = _scaled(read.points, read.normals, units, expected)
    step_m = read.step * UNITS[scan.units or "m"]
    if step_m > COARSE_M:
        raise ShapeError(
            f"{path}: coordinates so far from the origin are stored as float32 in steps of "
            f"{1e3 * step_m:.3g} mm; at most {1e3 * COARSE_M:g} mm: subtract an offset before "
            "saving, or save them as double"
        )
    if step_m > NOTED_M:
        return replace(scan, note=f"{scan.note}; stored in steps of {1e3 * step_m:.2g} mm")
    return scan


def check_file(path: Path, units: str = "auto") -> str:
    """Refuse what cannot be a scan's file, unread; return its suffix.

    Raises
    ------
    ShapeError
        If there is no such file, or its kind or the unit is unknown.
    """
    if units != "auto" and units not in UNITS:
        raise ShapeError(f"units={units!r}; expected auto, {', '.join(UNITS)}")
    if path.is_dir():
        raise ShapeError(f"{path}: a folder, no scan; name the files in it")
    if not path.is_file():
        raise ShapeError(f"{path}: {'no regular file' if path.exists() else 'no such file'}")
    kind = path.suffix.lower()
    if kind not in MESH_FORMATS + TEXT_FORMATS:
        known = " ".join(MESH_FORMATS + TEXT_FORMATS)
        raise ShapeError(f"{path}: unknown kind of file {kind!r}; known: {known}")
    return kind


def _scaled(points: Array, normals: Array | None, units: str, expected: Expected) -> StoredScan:
    finite = points[are_positions(points)]
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


@dataclass(frozen=True, eq=False)
class _Read:
    """Points and normals of a file, and by how much the least bit of float32 moves them."""

    points: Array
    normals: Array | None
    step: float = 0.0


def _step(points: Array) -> float:
    """Return the step of the largest coordinate if all of them are float32, else 0."""
    finite = points[are_positions(points)]
    with np.errstate(over="ignore"):
        single = finite.astype(np.float32)
    if len(finite) == 0 or not np.array_equal(single, finite):
        return 0.0
    return float(np.spacing(np.abs(single).max()))


def _text(path: Path) -> _Read:
    rows: list[list[float]] = []
    with open(path, encoding="utf-8") as lines:
        for number, line in enumerate(lines, start=1):
            words = line.replace(",", " ").split()
            if words and not words[0].startswith("#"):
                rows.append(_numbers(words, number, len(rows[0]) if rows else len(words)))
    if not rows:
        return _Read(np.zeros((0, 3)), None)
    table = np.array(rows, dtype=np.float64)
    normals = table[:, 3:6] if table.shape[1] == 6 else None
    if normals is not None and not _are_unit(normals):
        normals = None  # colours
    return _Read(table[:, :3], normals)


def _numbers(words: list[str], line: int, expected: int) -> list[float]:
    """Read one row of a text; as many numbers as in the first."""
    if len(words) != expected or expected < 3:
        wanted = expected if expected >= 3 else "x y z [nx ny nz]"
        raise ValueError(f"line {line} has {len(words)} words; expected {wanted}")
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise ValueError(f"line {line}: {error}") from None


def _are_unit(vectors: Array) -> bool:
    length = np.linalg.norm(vectors, axis=1)
    known = length[np.isfinite(length) & (length > 0)]
    return len(known) > 0 and bool((np.abs(known - 1) < UNIT).mean() > 0.9)


def _mesh(path: Path, wanted: int) -> _Read:
    import trimesh

    loaded: Any = trimesh.load(path, process=False)
    if isinstance(loaded, trimesh.Scene):
        parts = [g for g in loaded.dump() if hasattr(g, "vertices")]
        if not parts:
            return _Read(np.zeros((0, 3)), None)
        meshes = [p for p in parts if isinstance(p, trimesh.Trimesh)]
        loaded = trimesh.util.concatenate(meshes) if meshes else parts[0]
    points = np.asarray(loaded.vertices, dtype=np.float64)
    step = _step(points)
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        return _Read(points, _ply_normals(loaded), step)
    faces = np.asarray(loaded.faces, dtype=np.int64)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    faces = faces[finite[faces].all(axis=1)]
    safe = np.where(finite[:, None], points, 0)
    normals = vertex_normals(safe, faces)
    if len(points) >= FINE * wanted:
        used = np.unique(faces)
        return _Read(points[used], normals[used], step)
    return _Read(*_sampled(safe, faces, normals, wanted), step)


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
