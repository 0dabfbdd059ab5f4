"""A drawing of a rig: cameras, projectors, fields of view and the working volume, to scale."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera
from synthgen.scanner.rig import Rig

Array = NDArray[np.float64]

GREY, COLOUR, SPECKLE, BOX, GLASS = "#1f4e79", "#b5441c", "#3b8132", "#555555", "#5ab4c4"
# Which world axes go right and up in each flat view.
_VIEWS = (("from above", 0, 2, "x", "z"), ("from the front", 0, 1, "x", "y"))


def draw(rig: Rig, path: Path) -> None:
    """Write the drawing as a PNG: in space, from above and from the front, axes in metres."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{rig.name}: {rig.summary}")
    lines = _lines(rig)
    space: Any = figure.add_subplot(1, 3, 1, projection="3d")
    for points, colour, width in lines:
        x, y, z = points.T
        space.plot(x, z, y, color=colour, linewidth=width)
    space.set(xlabel="x, m", ylabel="z, m", zlabel="y, m")
    space.view_init(elev=22, azim=60)
    space.set_aspect("equal")
    for k, (title, across, up, name_across, name_up) in enumerate(_VIEWS):
        axes: Any = figure.add_subplot(1, 3, 2 + k)
        for points, colour, width in lines:
            axes.plot(points[:, across], points[:, up], color=colour, linewidth=width)
        if k == 0:
            _name_units(axes, rig)
            axes.invert_yaxis()  # the front, +z, is at the bottom
        axes.set(title=title, xlabel=f"{name_across}, m", ylabel=f"{name_up}, m")
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.25)
    _legend(figure, {colour for _, colour, _ in lines})
    figure.savefig(path, dpi=100)


def _lines(rig: Rig) -> list[tuple[Array, str, float]]:
    reach = 0.14 * max(float(np.linalg.norm(u.nominal.left.position)) for u in rig.units)
    found = []
    for unit in rig.units:
        cameras = [(unit.nominal.left, GREY), (unit.nominal.right, GREY)]
        if unit.nominal.colour is not None:
            cameras.append((unit.nominal.colour, COLOUR))
        found += [(_frustum(camera, reach), colour, 1.2) for camera, colour in cameras]
    found += [(_frustum(p.optics, 0.8 * reach), SPECKLE, 1.0) for p in rig.projectors]
    found.append((_box(-np.array(rig.volume_m) / 2, np.array(rig.volume_m) / 2), BOX, 1.6))
    if rig.glass is not None:
        half = np.array([0.75 * rig.volume_m[0], 0, 0.75 * rig.volume_m[2]])
        top = np.array([0, rig.glass.top_m, 0])
        found.append((_box(top - half - [0, rig.glass.thickness_m, 0], top + half), GLASS, 1.2))
    return found


def _frustum(camera: Camera, reach: float) -> Array:
    """One stroke around a camera's pyramid, ``reach`` metres deep."""
    right = np.array([-camera.cx, camera.width - 1 - camera.cx]) / camera.fx
    down = np.array([-camera.cy, camera.height - 1 - camera.cy]) / camera.fy
    corners = np.array([[x, y, 1.0] for x, y in zip(right[[0, 1, 1, 0]], down[[0, 0, 1, 1]],
                                                    strict=True)]) * reach  # fmt: skip
    tip = np.zeros(3)
    a, b, c, d = corners
    stroke = np.array([tip, a, b, tip, c, d, tip, a, d, c, b])
    return np.asarray(stroke @ camera.T[:3, :3].T + camera.position)


def _box(low: Array, high: Array) -> Array:
    """One stroke along the edges of a box."""
    order = [0, 1, 3, 2, 0, 4, 5, 1, 5, 7, 3, 7, 6, 2, 6, 4]
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    return np.asarray((low + corners * (high - low))[order])


def _name_units(axes: Any, rig: Rig) -> None:
    for unit in rig.units:
        middle = (unit.nominal.left.position + unit.nominal.right.position) / 2
        out = middle * 1.08
        axes.annotate(unit.ident, (out[0], out[2]), ha="center", va="center", fontsize=8)


def _legend(figure: Any, used: set[str]) -> None:
    from matplotlib.lines import Line2D

    names = {"stereo camera": GREY, "colour camera": COLOUR, "projector": SPECKLE,
             "working volume": BOX, "glass": GLASS}  # fmt: skip
    handles = [Line2D([], [], color=c, label=name) for name, c in names.items() if c in used]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
