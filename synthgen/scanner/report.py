"""What a scan did, in JSON types: per unit what it saw and lost, and what was not as asked."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.scanner.exposure import Exposure, unit_time
from synthgen.scanner.match import DisparityGrid
from synthgen.scanner.range_grid import RangeGrid
from synthgen.scanner.rig import Rig, Unit
from synthgen.scanner.rows import RowOffset
from synthgen.scanner.stage import Stage

Report = dict[str, Any]
# Rows that are off by less hardly disturb matching.
NOTABLE_PX = 0.2
# Found by going on from neighbours that lie within.
NOTABLE_SHARE = 0.01


def scan_report(stage: Stage, units: dict[str, Report]) -> Report:
    """Return the report of a scan.

    Returns
    -------
    dict
        ``rig``, ``rig_digest``, ``scanner_seed``; ``velocity_m_s`` (3,) by which all solids moved
        as one, in the rig's frame; ``notes``, sentences about what could not be done as asked or
        was put right; ``units``, by id, see :func:`unit_report`.
    """
    rig = stage.rig
    return {
        "rig": rig.name,
        "rig_digest": rig.digest,
        "scanner_seed": rig.seed,
        "velocity_m_s": stage.velocity_m_s.tolist(),
        "notes": [*_calibration(rig), *stage.notes, *_rows(units), *_reach(units)],
        "units": units,
    }


def unit_report(
    stage: Stage, unit: Unit, grid: DisparityGrid, points: RangeGrid | None,
    bounds: tuple[float, float], problem: str | None,
) -> Report:  # fmt: skip
    """Return what one unit did.

    Returns
    -------
    dict
        ``problem`` (why it gave nothing, or what is doubtful) or None; ``time_s`` of its exposure;
        ``lit_by``, its projectors; ``epipolar_rms_px``, by how much its rows do not correspond;
        ``searched_px`` and ``found_px``, lowest and highest disparity, and ``beyond``, the share of
        what was found that lies beyond what was searched; counts of samples of its grid:
        ``matched``, and of these ``kept`` off edges and steep places.
    """
    found = grid.disparity[grid.matched]
    beyond = (found < bounds[0]) | (found > bounds[1])
    return {
        "problem": problem,
        "time_s": unit_time(stage, unit),
        "lit_by": [projector.ident for projector in stage.rig.lit_by(unit)],
        "epipolar_rms_px": stage.rig.epipolar_px[unit.index],
        "searched_px": list(bounds),
        "found_px": [float(found.min()), float(found.max())] if len(found) else None,
        "beyond": float(beyond.mean()) if len(found) else 0.0,
        "matched": len(found),
        "kept": 0 if points is None else int(points.known.sum()),
    }


def picture_report(
    shot: Exposure, rig: Rig, textured: NDArray[np.bool_] | None, rows: RowOffset | None
) -> Report:
    """Return what is known beyond that where pictures were taken.

    Returns
    -------
    dict
        ``gain``, full wells per unit of radiance; ``saturated``, share of the left picture's pixels
        at full scale; ``lit``, samples that are bright and textured, of which those that were not
        ``matched`` were lost; ``row_offset``, how the rows were put right, or None.
    """
    return {
        "gain": shot.gain,
        "saturated": float((rig.grey.saturation & (shot.left >= rig.grey.full_scale)).mean()),
        "lit": 0 if textured is None else int(textured.sum()),
        "row_offset": None if rows is None else asdict(rows),
    }


def _calibration(rig: Rig) -> list[str]:
    if rig.draws == 1:
        return []
    return [
        f"{rig.draws - 1} calibration draw(s) of scanner seed {rig.seed} were refused: a unit had "
        f"more than {rig.error.epipolar_limit_px:g} px of epipolar RMS"
    ]


def _rows(units: dict[str, Report]) -> list[str]:
    moved = {ident: r["row_offset"]["middle"] for ident, r in units.items() if r.get("row_offset")}
    return [
        f"unit {ident}: rows were put right by {offset:+.2f} px"
        for ident, offset in moved.items()
        if abs(offset) > NOTABLE_PX
    ]


def _reach(units: dict[str, Report]) -> list[str]:
    """Tell where the subject reaches out of the working volume's depths."""
    return [
        f"unit {ident}: the subject reaches beyond the working volume's disparities, "
        f"{r['searched_px'][0]:.0f}..{r['searched_px'][1]:.0f} px, where it is measured in part "
        "only; enlarge the rig's volume_m or move the subject"
        for ident, r in units.items()
        if r["beyond"] > NOTABLE_SHARE
    ]
