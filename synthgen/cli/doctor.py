"""``synthgen doctor``: can the default job run on this machine, and if not, what to do."""

from __future__ import annotations

import json
import platform
from importlib import metadata
from typing import Any

from synthgen import __version__
from synthgen.cli.options import Json
from synthgen.cli.output import DONE, FAILED, Result, columns
from synthgen.errors import SynthgenError

LIBRARIES = (
    "numpy", "scipy", "mitsuba", "drjit", "OpenEXR", "opencv-python-headless", "trimesh", "torch",
    "kornia", "numba", "libigl", "scikit-learn", "scikit-image", "pydantic", "PyYAML", "typer",
    "rich", "pyarrow", "jaxtyping", "matplotlib", "threadpoolctl",
)  # fmt: skip
REINSTALL = "pip install --force-reinstall synthgen"


def doctor(as_json: Json = False) -> Result:
    """Report back ends, LLVM, GPU, models and libraries; exit 1 if the default job cannot run."""
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
