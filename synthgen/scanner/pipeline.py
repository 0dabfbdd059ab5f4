"""From a mesh to its scan: every unit's measurement, fusion, colours, provenance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ScanError
from synthgen.geometry.normals import vertex_normals
from synthgen.sampling.streams import stream
from synthgen.scanner.atlas import build_atlas
from synthgen.scanner.calibration import in_frame, volume_points
from synthgen.scanner.census import match_census
from synthgen.scanner.colour import ColourView, colour_vertices
from synthgen.scanner.exposure import Exposure, expose, unit_time, unlit
from synthgen.scanner.ideal import ideal_disparity
from synthgen.scanner.isosurface import extract
from synthgen.scanner.match import DisparityGrid, lit, match
from synthgen.scanner.noise import add_noise, load_noise, strength_on
from synthgen.scanner.provenance import measured_by, truth_of
from synthgen.scanner.range_grid import RangeGrid, range_grid
from synthgen.scanner.rectify import Rectified, rectify, rectify_images
from synthgen.scanner.report import Report, picture_report, scan_report, unit_report
from synthgen.scanner.result import Level, Scan, UnitScan, empty_scan
from synthgen.scanner.rig import Rig, Unit
from synthgen.scanner.rows import find_row_offset, refracted_rows
from synthgen.scanner.scaling import scaled
from synthgen.scanner.settings import ScanSettings, check_level, settings_for
from synthgen.scanner.stage import Effects, Stage, prepare
from synthgen.scanner.subject import ScanScene, scene_of
from synthgen.scanner.support import cut_unsupported
from synthgen.scanner.tsdf import fuse
from synthgen.scanner.white import expose_colour

LEAST_MATCHED = 0.3
_LOST = "every matched point looks like an edge; the surface is too small or too steep"
_UNSEEN = "its two cameras together see nothing of the subject"


@dataclass(frozen=True, eq=False)
class Measurement:
    """What one unit gave: its part of the scan, its points, its colour picture, what it did."""

    unit: UnitScan
    grid: RangeGrid | None
    view: ColourView | None
    report: Report


def scan(
    mesh_or_scene: Any,
    rig: Rig,
    *,
    rng: np.random.Generator,
    level: Level = "full",
    settings: ScanSettings | None = None,
    effects: Effects | None = None,
) -> Scan:
    """Scan something.

    Parameters
    ----------
    mesh_or_scene : trimesh.Trimesh or ScanScene
        Metres, in the rig's frame (origin at the centre of the working volume, y up). A mesh gets
        the default skin.
    rig : Rig
        See :func:`synthgen.scanner.load_rig`.
    rng : numpy.random.Generator
        Of this scan's noise; the scanner's own flaws are frozen in the rig.
    level : {"full", "half", "model"}
        Full resolution; half the pixels along each edge; or no grey pictures at all: ideal
        disparities with a noise model that was fitted to full ones.
    settings : ScanSettings, optional
        Default :func:`settings_for` of the rig and level.
    effects : Effects, optional
        Switches of what makes light.

    Returns
    -------
    Scan
        Where nothing could be measured it is empty, and ``problem`` says which unit failed and
        why; a unit that failed beside others says so in its own ``problem``.

    Raises
    ------
    ScanError
        If the subject is outside the working volume or a camera inside a solid.
    ShapeError
        If what is given is no mesh of triangles, or ``rng`` no generator.
    ConfigError
        If there is no such level, or the samples per pixel are no square number.
    """
    check_level(level)
    chosen = settings or settings_for(rig, level)
    scene = scene_of(mesh_or_scene)
    used = scaled(rig, 0.5) if level == "half" else rig
    stage = prepare(scene, used, rng=rng, effects=effects or Effects())
    parts = [measure(stage, unit, level, chosen) for unit in used.units]
    report = scan_report(stage, {part.unit.ident: part.report for part in parts})
    return replace(assemble(parts, scene, level, chosen), report=report)


def assemble(
    parts: Sequence[Measurement], scene: ScanScene, level: Level, settings: ScanSettings
) -> Scan:
    """Fuse what the units measured; ``scene`` is what provenance refers to."""
    units = tuple(part.unit for part in parts)
    grids = [part.grid for part in parts if part.grid is not None]
    rows = [k for k, part in enumerate(parts) if part.grid is not None]
    try:
        field = fuse(grids, settings.fusion)
        vertices, faces = extract(field, settings.fusion.least_faces, settings.fill_voxels)
        if not settings.fill_voxels:
            vertices, faces = cut_unsupported(vertices, faces, grids, settings.fusion)
    except ScanError as error:
        return empty_scan(units, level, f"{error}. {'; '.join(map(_account, parts))}")
    normals = vertex_normals(vertices, faces)
    views = [part.view for part in parts if part.view is not None]
    coloured = colour_vertices(vertices, normals, faces, views)
    atlas = build_atlas(coloured, faces, views)
    measured = measured_by(vertices, grids, settings.fusion.truncation * settings.fusion.voxel_m)
    unit = np.where(measured.unit >= 0, np.array(rows, np.int16)[measured.unit], -1)
    provenance: dict[str, NDArray[Any]] = {
        "unit": unit.astype(np.int16),
        "confidence": measured.confidence,
        "sigma_m": measured.sigma_m,
        "colour_unit": coloured.view,
    }
    if settings.truth:
        truth = truth_of(vertices, scene)
        provenance |= {"solid": truth.solid, "face": truth.face, "error_m": truth.error_m,
                       "barycentric": truth.barycentric}  # fmt: skip
    return Scan(
        vertices=vertices.astype(np.float32),
        normals=normals.astype(np.float32),
        faces=faces.astype(np.int32),
        colors=coloured.colors,
        uv=atlas.uv,
        corner_uv=atlas.corner_uv,
        texture=atlas.texture,
        provenance=provenance,
        units=units,
        level=level,
    )


def _account(part: Measurement) -> str:
    """Say what a unit has to do with an empty scan."""
    count = 0 if part.grid is None else int(part.grid.known.sum())
    return part.unit.problem or f"unit {part.unit.ident}: measured {count} points"


def measure(stage: Stage, unit: Unit, level: Level, settings: ScanSettings) -> Measurement:
    """Let one unit measure the scene; what goes wrong is told in the result's ``problem``."""
    pair = rectify(unit.nominal.left, unit.nominal.right)
    if level == "model":
        got = _modelled(stage, unit, pair, settings)
    else:
        got = _matched(stage.rig, pair, expose(stage, unit, spp=settings.spp), settings)
    grid, problem, true = got.grid, got.problem, None
    if settings.true_disparity:
        true = ideal_disparity(stage, unit, pair, grid.step, time_s=unit_time(stage, unit))
    view = None
    if settings.colour and unit.nominal.colour is not None:
        view = ColourView(unit.nominal.colour, expose_colour(stage, unit), stage.rig.glass)
    points = None
    if grid.matched.any():
        points = range_grid(pair, grid, settings.grid, stage.rig.glass)
        points = points if points.known.any() else None
    if points is None and problem is None:
        problem = f"unit {unit.ident}: {_LOST if grid.matched.any() else _UNSEEN}"
    bounds = disparity_bounds(stage.rig, pair)
    report = unit_report(stage, unit, grid, points, bounds, problem) | got.report
    left, right = got.pictures or (None, None)
    done = UnitScan(unit.ident, pair, left, right, grid.disparity, grid.step, true, problem)
    return Measurement(done, points, view, report)


def depth_bounds(rig: Rig, pair: Rectified) -> tuple[float, float]:
    """Return the depths, metres, between which the working volume lies for a pair.

    What is nearer than two baselines is left out, as long as half of the depth remains.
    """
    edges = np.array(rig.volume_m) / 2
    corners = np.array(list(np.ndindex(2, 2, 2))) * 2 * edges - edges
    depth = (corners - pair.camera.position) @ pair.camera.T[:3, 2]
    far = float(depth.max())
    return max(float(depth.min()), min(2 * pair.baseline_m, far / 2)), far


def disparity_bounds(rig: Rig, pair: Rectified) -> tuple[float, float]:
    """Return the disparities, pixels, of the working volume's far and near end."""
    near, far = depth_bounds(rig, pair)
    return float(pair.disparity(far)), float(pair.disparity(near))


@dataclass(frozen=True, eq=False)
class Matched:
    """Rectified pictures (8 bits), disparities, what is wrong with them, what was done."""

    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]] | None
    grid: DisparityGrid
    problem: str | None
    report: Report


def _matched(rig: Rig, pair: Rectified, shot: Exposure, settings: ScanSettings) -> Matched:
    """Rectify and match one exposure."""
    scale = 255 / rig.grey.full_scale
    raw = shot.left * np.float32(scale), shot.right * np.float32(scale)
    known = refracted_rows(pair, rig.glass, rig.volume_m)
    lower = None if known is None else known.over(raw[0].shape)
    left, right = rectify_images(pair, raw, lower)
    bounds, problem = disparity_bounds(rig, pair), shot.problem
    grid = _nothing(left.shape, settings.match.step)
    textured, rows = None, None
    if problem is None:
        try:
            if rig.reconstruction.matcher == "census":
                grid = match_census(left, right, bounds)
            else:
                rows = find_row_offset(left, right, bounds, settings.match)
                if rows is not None:
                    found = rows.over(left.shape)
                    both = found if lower is None else found + lower
                    left, right = rectify_images(pair, raw, both)
                grid = match(left, right, bounds, settings.match)
            textured = lit(left, settings.match)[:: grid.step, :: grid.step]
            problem = _doubt(rig, pair, textured, grid)
        except ScanError as error:
            problem = str(error)
    if problem is not None and not problem.startswith("unit "):
        problem = f"unit {shot.unit.ident}: {problem}"
    whole = [np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in (left, right)]
    report = picture_report(shot, rig, textured, rows)
    return Matched((whole[0], whole[1]), grid, problem, report)


def _doubt(
    rig: Rig, pair: Rectified, textured: NDArray[np.bool_], grid: DisparityGrid
) -> str | None:
    share = float((grid.matched & textured).sum() / max(textured.sum(), 1))
    if share >= LEAST_MATCHED:
        return None
    points = volume_points(rig.volume_m, 9)
    if not (in_frame(pair.left, points) & in_frame(pair.right, points)).any():
        return (
            "its two cameras see no part of the working volume together: aim them at it "
            "(`pair.axes: toed_in` or `shifted`), or choose a smaller baseline or a wider field"
        )
    near, far = depth_bounds(rig, pair)
    low, high = disparity_bounds(rig, pair)
    return (
        f"only {100 * share:.0f} % of what is lit was matched within the working volume's "
        f"disparities {low:.0f}..{high:.0f} px (depth {near:.3f}..{far:.3f} m): the disparity "
        "range is too small for the subject (enlarge the rig's volume_m or move the subject), or "
        "the pictures are blurred, or their rows do not correspond (`reconstruction.rows` of the "
        "rig's file looks over neighbouring ones)"
    )


def _nothing(shape: tuple[int, ...], step: int) -> DisparityGrid:
    rows, columns = (-(-n // step) for n in shape)
    blank = np.full((rows, columns), np.nan, np.float32)
    return DisparityGrid(blank, blank, np.zeros_like(blank), step, (shape[0], shape[1]))


def _modelled(stage: Stage, unit: Unit, pair: Rectified, settings: ScanSettings) -> Matched:
    """Ideal disparities with the noise of the rig's matcher."""
    step, problem = settings.match.step, unlit(stage.rig, unit)
    shape = pair.camera.height, pair.camera.width
    if problem is not None:
        return Matched(None, _nothing(shape, step), problem, {})
    ideal = ideal_disparity(stage, unit, pair, step, time_s=unit_time(stage, unit))
    model = load_noise("consumer" if stage.rig.reconstruction.matcher == "census" else "hand5")
    rng = stream(stage.key, "sample", unit.index, 0, "matching")
    strength = strength_on([part.solid for part in stage.mesh.parts], model)
    grid = add_noise(ideal, step, shape, model, rng=rng, strength=strength)
    return Matched(None, grid, None, {})
