"""``synthgen doctor``: can the default job run on this machine, and if not, what to do."""

from __future__ import annotations

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import typer

from synthgen import __version__
from synthgen.cli.options import Json
from synthgen.cli.output import DONE, FAILED, Result, columns
from synthgen.errors import ConfigError, SynthgenError

LIBRARIES = (
    "numpy", "scipy", "mitsuba", "drjit", "OpenEXR", "opencv-python-headless", "trimesh", "torch",
    "kornia", "numba", "libigl", "scikit-learn", "scikit-image", "pydantic", "PyYAML", "typer",
    "rich", "pyarrow", "jaxtyping", "matplotlib", "threadpoolctl",
)  # fmt: skip
# By folder, never by name: the package index has another project of the name.
REINSTALL = "run `pip install --force-reinstall .` in a checkout of synthgen"


What = Annotated[str | None, typer.Argument(metavar="rig", help="Examine a scanner instead.")]
Name = Annotated[str | None, typer.Argument(metavar="NAME", help="Its name, or a .yaml file.")]
Seed = Annotated[int, typer.Option("--seed", help="Scanner seed: which calibration draw.")]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="Rig picture; rig_NAME.png otherwise.")
]


def doctor(
    what: What = None, name: Name = None, seed: Seed = 0, out: Out = None, as_json: Json = False
) -> Result:
    """Report back ends, models and libraries; exit 1 if the default job cannot run.

    `doctor rig NAME` reports a scanner instead: its working volume and what it resolves there, and
    draws it.
    """
    if what is not None:
        return _rig(what, name, seed, out)
    payload: dict[str, Any] = {
        "synthgen": __version__,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "libraries": {name: _version(name) for name in LIBRARIES},
    }
    problems = [
        f"{name} is not installed: pip install {name}"
        for name, version in payload["libraries"].items()
        if version is None
    ]
    for name, examine in (("backend", _backend), ("models", _models), ("presets", _presets)):
        payload[name], found = _guarded(examine)
        problems += found
    payload |= {"ok": not problems, "problems": problems}
    return Result(payload, _lines(payload), FAILED if problems else DONE)


def _rig(what: str, name: str | None, seed: int, out: Path | None) -> Result:
    from synthgen.scanner import list_rigs, load_rig
    from synthgen.scanner.rig_picture import draw
    from synthgen.scanner.rig_report import describe, problems

    if what != "rig" or name is None:
        raise ConfigError(
            f"doctor {what}: write `synthgen doctor rig NAME`; rigs are {', '.join(list_rigs())}"
        )
    rig = load_rig(name, seed)
    picture = out or Path(f"rig_{rig.name}.png")
    draw(rig, picture)
    report = describe(rig)
    found = problems(report)
    report |= {"picture": str(picture), "ok": not found, "problems": found}
    return Result(report, _rig_lines(report), FAILED if found else DONE)


def _rig_lines(report: dict[str, Any]) -> list[str]:
    x, y, z = report["volume_m"]
    head = [
        ("rig", f"{report['rig']}: {report['summary']}"),
        ("volume", f"{x:g} x {y:g} x {z:g} m; {report['seen_by_one']:.0%} of it is seen by a unit, "
                   f"{report['seen_by_two']:.0%} by two"),
        ("light", f"{report['projectors']} projectors, {report['fps']:g} fps"),
        ("scanner seed", f"{report['seed']} (calibration draw {report['calibration_draws']})"),
        ("our choice", ", ".join(report["own_choices"]) or "nothing"),
        ("picture", report["picture"]),
    ]  # fmt: skip
    table = [("unit", "baseline m", "depth m", "GSD mm", "mm per px", "disparities", "epipolar px")]
    for unit in report["units"]:
        depth, gsd, step = unit["depth_m"], unit["gsd_m"], unit["depth_per_px_m"]
        seen = depth is not None
        table.append((
            unit["unit"],
            f"{unit['baseline_m']:.3f}",
            f"{depth[0]:.3f}..{depth[1]:.3f}" if seen else "-",
            f"{1e3 * gsd[0]:.3f}..{1e3 * gsd[2]:.3f}" if seen else "-",
            f"{1e3 * step[0]:.2f}..{1e3 * step[2]:.2f}" if seen else "-",
            f"{unit['disparities']:.0f}" if seen else "-",
            f"{unit['epipolar_rms_px']:.2f}",
        ))  # fmt: skip
    return [*columns(head), "", *columns(table), *report["problems"]]


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _guarded(examine: Any) -> tuple[Any, list[str]]:
    """Run one examination; what it cannot stand is a finding, since a doctor must not die."""
    try:
        result: tuple[Any, list[str]] = examine()
        return result
    except (SynthgenError, ImportError, OSError) as error:
        return None, [f"{error} ({REINSTALL})" if isinstance(error, ImportError) else str(error)]


def _backend() -> tuple[Any, list[str]]:
    from synthgen.render import backend

    report = backend.report()
    return report, [report["problem"]] if report["problem"] else []


def _models() -> tuple[Any, list[str]]:
    from synthgen.models import list_models, load

    found: dict[str, Any] = {}
    for name, path in list_models().items():
        try:
            found[name] = {"path": str(path), "licence": _licence(load(name).provenance)}
        except SynthgenError as error:
            found[name] = {"path": str(path), "error": str(error)}
    shipped = found.get("cc0-hand", {"error": f"the shipped model is missing: {REINSTALL}"})
    return found, [shipped["error"]] if "error" in shipped else []


def _licence(provenance: str) -> str:
    try:
        content = json.loads(provenance)
    except ValueError:
        return "your own file, under its own licence"
    return str(content.get("licence", "not stated"))


def _presets() -> tuple[Any, list[str]]:
    from synthgen.config import data_folder, list_presets, load_config

    data_folder("scenes")
    for name in list_presets():
        load_config(name)
    return sorted(list_presets()), []


def _lines(payload: dict[str, Any]) -> list[str]:
    backend = payload["backend"] or {}
    llvm = backend.get("llvm")
    rows = [
        ("synthgen", f"{payload['synthgen']}, Python {payload['python']}, {payload['machine']}"),
        ("back end", backend.get("variant") or "none works"),
        ("LLVM", f"{llvm['version']} ({llvm['path']})" if llvm else "none found"),
        ("CUDA", "works" if backend.get("cuda") else "not usable"),
        ("presets", ", ".join(payload["presets"] or [])),
    ]
    for name, model in (payload["models"] or {}).items():
        rows.append(("model", f"{name}: {model.get('licence') or model.get('error')}"))
    versions = payload["libraries"].items()
    rows.append(("libraries", " ".join(f"{n} {v}" for n, v in versions if v)))
    verdict = "the default job can run" if payload["ok"] else "the default job cannot run:"
    return [*columns(rows), "", verdict, *payload["problems"]]
