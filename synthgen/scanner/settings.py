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
_HALF_VOXEL, MAX_STEP = 1.25, 16


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
        """Refuse what no scan can be made with; raises ConfigError."""
        match, dic, grid, fusion = self.match, self.match.dic, self.grid, self.fusion
        odd = "an odd number from 3 on, pixels"
        for fine, name, value, allowed in (
            (match.step >= 1, "match.step", match.step, "1 pixel or more"),
            (match.block >= 3 and match.block % 2, "match.block", match.block, odd),
            (match.seed_scale in (1, 2), "match.seed_scale", match.seed_scale, "1 or 2"),
            (dic.window >= 3 and dic.window % 2, "match.dic.window", dic.window, odd),
            (dic.order in (1, 2), "match.dic.order", dic.order, "1 (affine) or 2 (quadratic)"),
            (dic.iterations >= 1, "match.dic.iterations", dic.iterations, "1 or more"),
            (dic.spread > 0, "match.dic.spread", dic.spread, "above 0"),
            (grid.bridge >= 0, "grid.bridge", grid.bridge, "0 or more samples"),
            (fusion.voxel_m > 0, "fusion.voxel_m", fusion.voxel_m, "above 0 metres"),
            (fusion.truncation >= 1, "fusion.truncation", fusion.truncation, "1 voxel or more"),
            (self.fill_voxels >= 0, "fill_voxels", self.fill_voxels, "0 (keeps holes) or more"),
        ):
            if not fine:
                raise ConfigError(f"settings: {name} = {value}; allowed is {allowed}")


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


def check_settings(settings: ScanSettings) -> None:
    """Refuse numbers that reconstruction cannot work with; raises ConfigError naming the value."""
    rules = (
        ("match.step", settings.match.step, 1, MAX_STEP),
        ("fusion.voxel_m", settings.fusion.voxel_m, 1e-5, 0.1),
        ("fusion.truncation", settings.fusion.truncation, 1.0, 20.0),
        ("fusion.least_faces", settings.fusion.least_faces, 1, np.inf),
        ("fill_voxels", settings.fill_voxels, 0.0, 100.0),
    )
    for name, value, low, high in rules:
        if not low <= value <= high:
            raise ConfigError(f"{name} = {value}; {low:g} to {high:g} is possible")
