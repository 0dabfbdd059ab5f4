"""How a scan is reconstructed: everything from matching to colours, by level."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from synthgen.errors import ConfigError
from synthgen.scanner.dic_reference import DicSettings
from synthgen.scanner.match import BEST, MatchSettings
from synthgen.scanner.range_grid import GridSettings
from synthgen.scanner.result import Level
from synthgen.scanner.rig import Rig
from synthgen.scanner.tsdf import FusionSettings

Preset = Literal["default", "best"]
_HALF_VOXEL, MAX_STEP, MAX_WINDOW = 1.25, 16, 101


@dataclass(frozen=True)
class ScanSettings:
    """Reconstruction.

    Attributes
    ----------
    match : MatchSettings
    grid : GridSettings
    fusion : FusionSettings
    fill_voxels : float
        0 keeps real holes; above, holes up to about twice this many voxels are closed.
    spp : int
        Light samples per pixel of the speckle pictures, a square number. Four leave a sampling
        noise of about 0.04 mm on a plane; sixteen cost two to three times as much.
    colour : bool
        Take colour pictures and colour the scan.
    truth : bool
        Tell for every vertex where on the true surface it belongs, and its error.
    true_disparity : bool
        Tell for every unit what an ideal matcher would have found.
    """

    match: MatchSettings = field(default_factory=MatchSettings)
    grid: GridSettings = field(default_factory=GridSettings)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    fill_voxels: float = 0.0
    spp: int = 4
    colour: bool = True
    truth: bool = True
    true_disparity: bool = False

    def __post_init__(self) -> None:
        """Refuse numbers that reconstruction cannot work with; ConfigError names the value."""
        match, dic, grid, fusion = self.match, self.match.dic, self.grid, self.fusion
        for name, value, low, high in (
            ("match.step", match.step, 1, MAX_STEP),
            ("match.block", match.block, 3, MAX_WINDOW),
            ("match.dic.window", dic.window, 3, MAX_WINDOW),
            ("match.dic.iterations", dic.iterations, 1, 1000),
            ("match.dic.spread", dic.spread, 0.1, 100.0),
            ("grid.bridge", grid.bridge, 0, 100),
            ("fusion.voxel_m", fusion.voxel_m, 1e-5, 0.1),
            ("fusion.truncation", fusion.truncation, 1.0, 20.0),
            ("fusion.least_faces", fusion.least_faces, 1, np.inf),
            ("fill_voxels", self.fill_voxels, 0.0, 100.0),
        ):
            if not low <= value <= high:
                raise ConfigError(f"{name} = {value}; {low:g} to {high:g} is possible")
        for name, value in (("match.block", match.block), ("match.dic.window", dic.window)):
            if value % 2 == 0:
                raise ConfigError(f"{name} = {value}; odd numbers are possible: it has a middle")
        for name, value in (("match.seed_scale", match.seed_scale), ("match.dic.order", dic.order)):
            if value not in (1, 2):
                raise ConfigError(f"{name} = {value}; 1 or 2 is possible")


def settings_for(rig: Rig, level: Level = "full", preset: Preset = "default") -> ScanSettings:
    """Return a rig's settings.

    Parameters
    ----------
    rig : Rig
        As loaded: at full resolution for every level.
    level : {"full", "half", "model"}
        ``half`` has half the pixels along each edge, a smaller window and larger voxels.
    preset : {"default", "best"}
        ``best`` refines with a quadratic shape function over 19 pixels: fewer outliers for three
        to four times the matching cost.

    Raises
    ------
    ConfigError
        If there is no such level or preset.
    """
    check_level(level)
    if preset not in ("default", "best"):
        raise ConfigError(f"preset {preset!r}; presets are default and best")
    asked = rig.reconstruction
    window, step, voxel = asked.window_px, asked.stride_px, asked.voxel_m
    if level == "half":
        window, step = max(9, 2 * int(0.35 * window) + 1), max(1, round(2 * step / 3))
        voxel *= _HALF_VOXEL
    match = MatchSettings(step=step, rows=asked.rows, dic=DicSettings(window=window))
    if preset == "best":
        match = replace(BEST, step=step, rows=asked.rows)
    return ScanSettings(match=match, fusion=FusionSettings(voxel_m=voxel))


def check_level(level: str) -> None:
    """Refuse what is no level; raises ConfigError."""
    if level not in ("full", "half", "model"):
        raise ConfigError(f"level {level!r}; levels are full, half, model")
