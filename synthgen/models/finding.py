"""Where model files are: shipped ones, and those in the folders of ``SYNTHGEN_MODELS``."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from synthgen.errors import ModelError, nearest
from synthgen.models.content import SUFFIXES

DATA = Path(__file__).parent / "data"


def list_models() -> dict[str, Path]:
    """Return models by name: shipped ones, then those in the folders of ``SYNTHGEN_MODELS``."""
    folders = [
        DATA,
        *map(Path, filter(None, os.environ.get("SYNTHGEN_MODELS", "").split(os.pathsep))),
    ]
    found: dict[str, Path] = {}
    for folder in folders:
        if folder.is_dir():
            for path in sorted(folder.iterdir()):
                if path.suffix in SUFFIXES and path.is_file():
                    found.setdefault(path.stem, path)
    return found


def find(name: str | Path) -> Path:
    """Return the file of a model's name or path.

    Raises
    ------
    ModelError
        If there is none.
    """
    if not isinstance(name, str | os.PathLike):
        raise ModelError(f"a model is named by text or a path, not by {name!r:.40}")
    path = Path(name)
    with suppress(OSError):  # a name that no file can have is not found, like any other
        if path.suffix in SUFFIXES and path.is_file():
            return path.resolve()
    models = list_models()
    if str(name) in models:
        return models[str(name)].resolve()
    raise ModelError(
        f"no model {str(name)!r:.200}{nearest(str(name), models)}; known are {sorted(models)}. "
        f"Give the path of a {', '.join(SUFFIXES)} file, or put its folder into SYNTHGEN_MODELS"
    )


def is_shipped(path: Path) -> bool:
    """Tell whether a file is one of synthgen's own."""
    return path.resolve().parent == DATA.resolve()


def twin(path: Path) -> Path | None:
    """Return the other hand's file beside a hand's, found by LEFT or RIGHT in its name."""
    for one, other in (("LEFT", "RIGHT"), ("left", "right"), ("RIGHT", "LEFT"), ("right", "left")):
        if one in path.name:
            beside = path.with_name(path.name.replace(one, other))
            return beside if beside.is_file() else None
    return None


def mano_pair(folder: Path) -> tuple[Path, Path] | None:
    """Return the left and right MANO files of a folder, if it has both."""
    for suffix in SUFFIXES:
        pair = folder / f"MANO_LEFT{suffix}", folder / f"MANO_RIGHT{suffix}"
        if all(path.is_file() for path in pair):
            return pair
    return None
