"""``synthgen fit``: register scans of hands and bodies."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from zipfile import BadZipFile

import typer

from synthgen.cli.options import Json
from synthgen.cli.output import DONE, FAILED, Result
from synthgen.errors import ConfigError

if TYPE_CHECKING:
    from synthgen.registration.fitted import Fit
    from synthgen.registration.reading import StoredScan

Scans = Annotated[
    list[Path],
    typer.Argument(metavar="SCAN...", help="PLY, OBJ, GLB or XYZ files; one hand or body each."),
]
Model = Annotated[
    str, typer.Option("--model", metavar="NAME", help="A hand or body model's name or path.")
]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the results.")]
Hand = Annotated[
    str, typer.Option("--hand", metavar="SIDE", help="auto, left or right (hand models only).")
]
Start = Annotated[
    str, typer.Option("--start", metavar="cold|FILE", help="cold, or a fit's .npz to start from.")
]
Coupled = Annotated[
    bool, typer.Option("--coupled", help="Also free the mesh, for detail that the model lacks.")
]
PresetName = Annotated[
    str,
    typer.Option(
        "--preset", metavar="NAME", help="fast, accurate or paper (the last two: hand models only)."
    ),
]
Units = Annotated[str, typer.Option("--units", metavar="UNIT", help="auto, m, mm, cm or inch.")]
Tracked = Annotated[
    bool, typer.Option("--sequence", help="Scans are frames of one subject: track it.")
]

Template = Annotated[
    str,
    typer.Option(
        "--template",
        metavar="WORD",
        help="With --sequence: track the subject's own template, yes, no or auto (where the model's"
        " shape is not the subject's).",
    ),
]


def fit(
    scans: Scans,
    out: Out,
    model: Model = "cc0-hand",
    hand: Hand = "auto",
    start: Start = "cold",
    coupled: Coupled = False,
    preset: PresetName = "fast",
    units: Units = "auto",
    sequence: Tracked = False,
    template: Template = "auto",
    as_json: Json = False,
) -> Result:
    """Fit a hand or body model to scans; parameters, mesh, picture and report go to --out."""
    if sequence:
        from synthgen.cli.fit_sequence import fit_sequence

        if preset != "fast":
            raise ConfigError(f"--preset {preset} is for single scans; leave it out of --sequence")
        return fit_sequence(scans, out, model, hand, _start(start), coupled=coupled,
                            template=template, units=units, progress=not as_json)  # fmt: skip
    if template != "auto":
        raise ConfigError(f"--template {template} is for --sequence; a single scan has no frames")
    from synthgen.models import load
    from synthgen.registration import fit as register
    from synthgen.registration.inspection import expected_of
    from synthgen.registration.reading import read_scan

    loaded: Any = load(model)
    first, expected = _start(start), expected_of(loaded)
    stored = [(path, read_scan(path, units, expected)) for path in scans]
    names = _names(scans)
    spared(scans, out, names)
    out.mkdir(parents=True, exist_ok=True)
    reports, lines = [], []
    for name, (path, scan) in zip(names, stored, strict=True):
        found = register(
            scan.points, scan.normals, loaded, first, hand, preset=preset, coupled=coupled
        )
        reports.append(_write(out, name, path, scan, found))
        lines.append(_line(path, scan, found))
    good = all(report["verdict"] != "fail" for report in reports)
    payload = {"out": str(out), "fits": reports}
    return Result(payload, [*lines, f"results in {out}"], DONE if good else FAILED)


def _names(scans: list[Path], reserved: Sequence[str] = ()) -> list[str]:
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


def _start(word: str) -> Any:
    import numpy as np

    if word == "cold":
        return "cold"
    try:
        with np.load(word, allow_pickle=False) as stored:
            last = ("expression",) if "expression" in stored else ()
            return tuple(stored[key] for key in ("shape", "pose", "translation", *last))
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise ConfigError(
            f"--start {word}: expected cold or a fit's .npz (shape, pose, translation): {error}"
        ) from error


def _write(out: Path, name: str, path: Path, scan: StoredScan, found: Fit) -> dict[str, Any]:
    """Write parameters, mesh, picture and report; return the report."""
    import numpy as np

    from synthgen.registration.overlay import draw_overlay, save_overlay

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
    surface = found.vertices
    if found.free_vertices is not None:
        files["free_mesh"] = f"{name}_free.ply"
        _write_mesh(out / f"{name}_free.ply", found.free_vertices, found.model.faces)
        surface = found.free_vertices
    title = f"{name}: {found.verdict} {found.reason} {found.hand or ''}"
    picture = draw_overlay(scan.points, surface, found.model.faces, title, _hands(found))
    save_overlay(out / f"{name}.png", picture)
    report = {
        "scan": str(path), "units": scan.units, "units_note": scan.note, **found.report,
        "hand": found.hand, "shape": found.shape.tolist(), "pose": found.pose.tolist(),
        "translation_m": found.translation.tolist(), "files": files,
    }  # fmt: skip
    if found.expression is not None:
        report["expression"] = found.expression.tolist()
    (out / f"{name}.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return report


def _hands(found: Fit) -> list[Any]:
    """Return the vertices of a body's hands, to be drawn closely."""
    from synthgen.models.joints import SIDES
    from synthgen.registration.body_fit import body_surface
    from synthgen.registration.body_schedule import hand_vertices

    if found.hand is not None or found.report.get("statistics") is None:
        return []
    return [hand_vertices(body_surface(found.model), side) for side in SIDES]


def _write_mesh(path: Path, vertices: Any, faces: Any) -> None:
    import trimesh

    trimesh.Trimesh(vertices, faces, process=False).export(path)


def _line(path: Path, scan: StoredScan, found: Fit) -> str:
    """One fit in words."""
    if (message := found.report.get("message")) is not None:
        return f"{path}: fail ({found.reason}): {message}"
    s = found.report["statistics"]
    reason = f" ({found.reason})" if found.reason else ""
    numbers = "" if s is None else (
        f"; noise {s['noise_mm']:.2f} mm, {100 * s['explained']:.1f} % explained, "
        f"vertices known to {s['predicted_vertex_sd_mm']['median']:.2f} mm"
    )  # fmt: skip
    seconds = found.report["cpu_s"]["total"]
    what = "body" if found.hand is None else f"{found.hand} hand"
    return f"{path}: {found.verdict}{reason}, {what}{numbers}; {scan.note}; {seconds:.1f} CPU s"
