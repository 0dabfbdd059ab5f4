"""Finding the presets and scenes that ship with synthgen."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from synthgen.errors import ConfigError, nearest

PACKAGE = Path(__file__).resolve().parents[1]
SUFFIXES = (".yaml", ".yml")


def data_folder(kind: Literal["configs", "scenes"]) -> Path:
    """Return the folder of shipped data: inside an installed package, or in the checkout.

    Raises
    ------
    ConfigError
        If neither exists, that is if the installation is damaged.
    """
    installed, checkout = PACKAGE / "_data" / kind, PACKAGE.parent / kind
    for folder in (installed, checkout):
        if folder.is_dir():
            return folder
    raise ConfigError(
        f"no folder {kind!r}: looked at {installed} and {checkout}. The installation is "
        "incomplete; install it again from a checkout"
    )


def list_presets() -> dict[str, Path]:
    """Return the shipped presets by name, sorted."""
    return {path.stem: path for path in sorted(data_folder("configs").glob("*.yaml"))}


def find_config(name: str, beside: Path | None = None) -> Path:
    """Return the file that a preset's name or a path means.

    Parameters
    ----------
    name : str
        A path when it ends in ``.yaml`` or ``.yml`` or holds a slash; a preset's name otherwise.
    beside : Path or None
        Folder that relative paths start from; None is the current folder.

    Raises
    ------
    ConfigError
        If there is no such preset or file.
    """
    if name.endswith(SUFFIXES) or "/" in name:
        path = (beside or Path()) / Path(name).expanduser()
        if path.is_file():
            return path
        raise ConfigError(f"no configuration file {path}; give a preset's name or a .yaml file")
    presets = list_presets()
    if name in presets:
        return presets[name]
    raise ConfigError(
        f"no preset {name!r}{nearest(name, presets)}; presets are {', '.join(presets)}. "
        "A file of your own is given by its path, ending in .yaml"
    )
