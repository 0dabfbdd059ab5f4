"""Numbers that tell what a rig can measure, per unit and in all."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import to_camera
from synthgen.scanner.calibration import in_frame, volume_points
from synthgen.scanner.exposure import unlit
from synthgen.scanner.rig import Rig, Unit


def describe(rig: Rig) -> dict[str, Any]:
    """Return a rig's numbers in JSON types.

    Depths are along the left camera's nominal axis, over the part of the working volume that both
    cameras see; ``gsd_m`` is the size of a pixel there, ``depth_per_px_m`` the change of depth
    for one pixel of disparity, each at the near end, the middle and the far end.
    """
    points = volume_points(rig.volume_m, 15)
    seen = np.stack([_both(unit, points) for unit in rig.units])
    count = seen.sum(axis=0)
    return {
        "rig": rig.name,
        "summary": rig.summary,
        "seed": rig.seed,
        "volume_m": list(rig.volume_m),
        "seen_by_one": float((count >= 1).mean()),
        "seen_by_two": float((count >= 2).mean()),
        "projectors": len(rig.projectors),
        "fps": rig.fps,
        "calibration_draws": rig.draws,
        "own_choices": list(rig.own_choices),
        "units": [_unit(rig, unit, points[s]) for unit, s in zip(rig.units, seen, strict=True)],
    }


def _both(unit: Unit, points: NDArray[Any]) -> NDArray[np.bool_]:
    return in_frame(unit.nominal.left, points) & in_frame(unit.nominal.right, points)


def _unit(rig: Rig, unit: Unit, points: NDArray[Any]) -> dict[str, Any]:
    left, right, colour = unit.nominal.left, unit.nominal.right, unit.nominal.colour
    baseline = float(np.linalg.norm(right.position - left.position))
    found: dict[str, Any] = {
        "unit": unit.ident,
        "position_m": ((left.position + right.position) / 2).tolist(),
        "pixels": [left.width, left.height],
        "colour_pixels": None if colour is None else [colour.width, colour.height],
        "baseline_m": baseline,
        "slot": unit.slot,
        "lit_by": [p.ident for p in rig.lit_by(unit)],
        "unlit": unlit(rig, unit),
        "epipolar_rms_px": rig.epipolar_px[unit.index],
        "depth_m": None,
        "gsd_m": None,
        "depth_per_px_m": None,
        "disparities": None,
    }
    if len(points):
        z = to_camera(left, points)[:, 2]
        depths = np.array([z.min(), (z.min() + z.max()) / 2, z.max()])
        found |= {
            "depth_m": depths[[0, 2]].tolist(),
            "gsd_m": (depths / left.fx).tolist(),
            "depth_per_px_m": (depths**2 / (left.fx * baseline)).tolist(),
            "disparities": float(left.fx * baseline * (1 / depths[0] - 1 / depths[2])),
        }
    return found


def problems(report: dict[str, Any]) -> list[str]:
    """Return what is wrong with a rig, in words."""
    found = []
    for unit in report["units"]:
        if unit["depth_m"] is None:
            found.append(
                f"unit {unit['unit']} sees nothing of the working volume with both cameras"
            )
        if unit["unlit"]:
            found.append(unit["unlit"])
    if report["seen_by_one"] == 0:
        found.append("no unit sees the working volume")
    return found
