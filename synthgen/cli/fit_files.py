"""The files of a fit: what they are called, and how they are written."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synthgen.cli.output import finite
from synthgen.errors import ConfigError

if TYPE_CHECKING:
    from synthgen.registration.fitted import Fit
    from synthgen.registration.reading import StoredScan


def names_of(scans: list[Path], reserved: Sequence[str] = ()) -> list[str]:
    """Name each scan's files; names that would meet, or be ``reserved``, are numbered."""
    stems = [path.stem for path in scans]
    names = [s if stems.count(s) == 1 else f"{s}_{k}" for k, s in enumerate(stems)]
    taken = [*names, *(f"{name}_free" for name in names), *reserved]
    return names if len(set(taken)) == len(taken) else [f"{s}_{k}" for k, s in enumerate(stems)]


def spared(scans: list[Path], out: Path, names: list[str]) -> None:
    """Refuse to write a mesh or picture over a scan that is read.

    Raises
    ------
    ConfigError
        If a result would have the path of a scan.
    """
    own = {path.resolve() for path in scans}
    for name in names:
        for end in (".ply", "_free.ply"):
            if (place := out / f"{name}{end}").resolve() in own:
                raise ConfigError(
                    f"--out {out}: the fitted mesh would replace the scan {place}; name another "
                    "folder, such as --out fits"
                )


def report_of(out: Path, name: str, key: str) -> dict[str, Any] | None:
    """Return the report of a fit that is there with all of its files, made from the same."""
    try:
        report = json.loads((out / f"{name}.json").read_text(encoding="utf-8"))
        same = report["made_from"] == key
        there = all((out / file).is_file() for file in report["files"].values())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return dict(report) if same and there else None


def write(
    out: Path, name: str, path: Path, scan: StoredScan, found: Fit, key: str | None = None
) -> dict[str, Any]:
    """Write parameters, mesh, picture and, last, the report; return the report.

    ``key`` names what decided the fit, for :func:`report_of`.
    """
    import numpy as np

    from synthgen.corpus.atomic import replace
    from synthgen.registration.overlay import draw_overlay, save_overlay

    (out / f"{name}.json").unlink(missing_ok=True)  # until all files beside it are the new ones

    arrays: dict[str, Any] = {
        "shape": found.shape, "pose": found.pose, "translation": found.translation,
        "vertices": found.vertices, "joints": found.joints, "vertex_sd_m": found.vertex_sd_m,
        "hand": np.array(found.hand or ""),
    }  # fmt: skip
    if found.expression is not None:
        arrays["expression"] = found.expression
    np.savez(out / f"{name}.npz", **arrays)
    files = {"parameters": f"{name}.npz", "mesh": f"{name}.ply", "picture": f"{name}.png"}
    _write_mesh(out / f"{name}.ply", found.vertices, found.model.faces)
    if found.free_vertices is not None:
        files["free_mesh"] = f"{name}_free.ply"
        _write_mesh(out / f"{name}_free.ply", found.free_vertices, found.model.faces)
    title = f"{name}: {found.verdict} {found.reason} {found.hand or ''}"
    picture = draw_overlay(scan.points, *_drawn(found), title, _hands(found))
    save_overlay(out / f"{name}.png", picture)
    report = {
        "scan": str(path), "units": scan.units, "units_note": scan.note, **found.report,
        "hand": found.hand, "shape": found.shape.tolist(), "pose": found.pose.tolist(),
        "translation_m": found.translation.tolist(), "files": files,
    }  # fmt: skip
    if found.expression is not None:
        report["expression"] = found.expression.tolist()
    if key is not None:
        report["made_from"] = key
    plain: dict[str, Any] = finite(report)
    replace(out / f"{name}.json", (json.dumps(plain, indent=2) + "\n").encode())
    return plain


def _drawn(found: Fit) -> tuple[Any, Any]:
    """Return vertices and faces of what was fitted to the scan: flat, or smooth through them."""
    from synthgen.geometry.subdivision import InterpolatingSubdivision
    from synthgen.scene.surface import LEVELS

    faces = found.model.faces
    if found.free_vertices is not None:
        return found.free_vertices, faces
    if not found.report.get("curved"):
        return found.vertices, faces
    smooth = InterpolatingSubdivision.build(faces, len(found.vertices), LEVELS)
    return smooth.apply(found.vertices), smooth.faces


def _hands(found: Fit) -> list[Any]:
    """Return the vertices of a body's hands, to be drawn closely."""
    from synthgen.models.joints import SIDES
    from synthgen.registration.body_fit import body_surface
    from synthgen.registration.body_schedule import hand_vertices

    if found.hand is not None or found.report.get("statistics") is None:
        return []
    return [hand_vertices(body_surface(found.model), side) for side in SIDES]


def _write_mesh(path: Path, vertices: Any, faces: Any) -> None:
    """Write a PLY; far from the origin as double, since float32 has not the digits."""
    import trimesh

    from synthgen.registration.far import origin_of

    if origin_of(vertices) is None:
        trimesh.Trimesh(vertices, faces, process=False).export(path)
    else:
        path.write_bytes(_double_ply(vertices, faces))


def _double_ply(vertices: Any, faces: Any) -> bytes:
    import numpy as np

    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}",
            *(f"property double {axis}" for axis in "xyz"), f"element face {len(faces)}",
            "property list uchar int vertex_indices", "end_header", ""]  # fmt: skip
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, faces
    return "\n".join(head).encode() + np.asarray(vertices, "<f8").tobytes() + rows.tobytes()
