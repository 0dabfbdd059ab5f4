"""From a rig's file to a scanner: poses, intrinsics, slides, and the frozen calibration draw."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from synthgen.config import data_folder
from synthgen.config.explain import explain
from synthgen.config.reading import read_yaml
from synthgen.errors import ConfigError, ShapeError, nearest
from synthgen.geometry.cameras import Camera, camera_from_K
from synthgen.geometry.transforms import look_at
from synthgen.sampling.streams import stream
from synthgen.scanner.calibration import epipolar_rms_px, perturbed
from synthgen.scanner.pattern import picture_bytes
from synthgen.scanner.rig import (
    MAX_PROJECTORS,
    Calibration,
    CalibrationError,
    Glass,
    Light,
    Pattern,
    Projector,
    Reconstruction,
    Rig,
    Sensor,
    Unit,
)
from synthgen.scanner.rig_file import MAX_ROWS, CameraSpec, PlaceSpec, RigSpec

Array = NDArray[np.float64]
TEXELS_PER_DOT = 5.0
MAX_SLIDE_PX = 4096
MAX_DRAWS = 200
# Epipolar RMS that a search over one more row copes with: errors are twice as large at edges.
TOLERATED_PX_PER_ROW = 0.5


def list_rigs() -> dict[str, Path]:
    """Return the shipped rigs by name, sorted."""
    return {path.stem: path for path in sorted((data_folder("scenes") / "rigs").glob("*.yaml"))}


def load_rig(name: str | Path, seed: int = 0) -> Rig:
    """Load a scanner.

    Parameters
    ----------
    name : str or Path
        A shipped rig's name, or the path of a YAML file.
    seed : int
        Scanner seed: one frozen draw of the true calibration, the slides and the sensors' fixed
        patterns.

    Raises
    ------
    ConfigError
        If there is no such rig, its file is wrong, ids overlap, no calibration draw stays within
        the epipolar limit, or the seed is negative or no integer.
    """
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigError(f"scanner seed {seed!r}; use an integer, 0 or more")
    path = _find(str(name))
    spec = read_spec(path)
    try:
        return build_rig(path.stem, spec, seed, path.parent)
    except (ConfigError, ShapeError) as error:  # also distortions that no lens has
        raise ConfigError(f"{path}: {error}") from None


def _digest(spec: RigSpec, folder: Path) -> str:
    """Hash every value that decides bytes, defaults and the user's slide included."""
    content = spec.model_dump(mode="json", exclude={"summary", "own_choices"})
    content["order"] = [list(spec.units), list(spec.projectors)]  # calibration and noise go by it
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    found = hashlib.sha256(text.encode())
    if spec.projector.pattern.image:
        found.update(picture_bytes(_slide_path(spec, folder)))
    return found.hexdigest()


def _slide_path(spec: RigSpec, folder: Path) -> str:
    """Return where the user's slide lies; a relative name is beside the rig's file."""
    image = spec.projector.pattern.image
    return str((folder / Path(image).expanduser()).resolve()) if image else ""


def read_spec(path: Path) -> RigSpec:
    """Read and validate one rig file."""
    document = read_yaml(path)
    origins = {"": str(path)}
    origins |= {key: f"{path}, line {line}" for key, line in document.lines.items()}
    try:
        return RigSpec.model_validate_json(json.dumps(document.content))
    except ValidationError as error:
        raise ConfigError(explain(error, RigSpec, origins)) from None


def _find(name: str) -> Path:
    if name.endswith((".yaml", ".yml")) or "/" in name:
        path = Path(name).expanduser()
        if path.is_file():
            return path
        raise ConfigError(f"no rig file {path}; give a rig's name or a .yaml file")
    rigs = list_rigs()
    if name in rigs:
        return rigs[name]
    raise ConfigError(
        f"no rig {name!r}{nearest(name, rigs)}; rigs are {', '.join(rigs)}. A file of your own "
        "is given by its path, ending in .yaml"
    )


def build_rig(name: str, spec: RigSpec, seed: int, folder: Path = Path()) -> Rig:
    """Build the scanner that a specification describes; ``folder`` is where pictures are."""
    nominal = {ident: _calibration(spec, place) for ident, place in spec.units.items()}
    error = CalibrationError(**spec.error.model_dump())
    limit = max(error.epipolar_limit_px, TOLERATED_PX_PER_ROW * spec.reconstruction.rows)
    error = replace(error, epipolar_limit_px=limit)
    true, rms, draws = _true(spec, list(nominal.values()), error, seed)
    units = tuple(
        Unit(ident, k, nominal[ident], true[k], place.slot)
        for k, (ident, place) in enumerate(spec.units.items())
    )
    light, glass = spec.light, spec.glass
    return Rig(
        name=name,
        summary=spec.summary,
        seed=seed,
        units=units,
        projectors=_projectors(spec, seed, folder),
        grey=Sensor(**spec.grey_sensor.model_dump()),
        colour=Sensor(**spec.colour_sensor.model_dump()),
        light=Light(
            light.ambient, light.background, light.white_m, light.white_size_m, light.white_delay_s
        ),
        volume_m=spec.volume_m,
        glass=None if glass is None else Glass(glass.top_m, glass.thickness_m, glass.ior),
        sync_s=spec.sync_s,
        slot_s=spec.slot_s,
        fps=spec.fps,
        error=error,
        epipolar_px=rms,
        draws=draws,
        reconstruction=Reconstruction(**spec.reconstruction.model_dump()),
        own_choices=spec.own_choices,
        digest=_digest(spec, folder),
    )


def place(where: PlaceSpec) -> Array:
    """Return ``T_world_from_unit`` (4, 4): OpenCV axes at the eye, looking at the target."""
    azimuth, elevation, roll = np.deg2rad([where.azimuth_deg, where.elevation_deg, where.roll_deg])
    heading = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    away = heading * np.cos(elevation) + [0.0, np.sin(elevation), 0.0]
    # Straight down and up, the picture's top is what lies beyond the target.
    steep = abs(where.elevation_deg) > 89.0
    up = tuple(-heading * np.sign(elevation)) if steep else (0.0, 1.0, 0.0)
    T = look_at(np.array(where.target_m) + where.distance_m * away, np.array(where.target_m), up)
    c, s = np.cos(roll), np.sin(roll)
    T[:3, :3] = T[:3, :3] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return T


def _offset(T: Array, right_up_forward: tuple[float, float, float]) -> Array:
    right, up, forward = right_up_forward
    return np.asarray(T[:3, 3] + T[:3, :3] @ [right, -up, forward])


def _towards(T: Array, eye: Array, target: Array) -> Array:
    """Return a pose at ``eye`` that looks at ``target`` with the unit's own upright."""
    return look_at(eye, target, tuple(-T[:3, 1]))


def _calibration(spec: RigSpec, where: PlaceSpec) -> Calibration:
    T, target = place(where), np.array(where.target_m)
    half = spec.pair.baseline_m / 2
    focal = where.distance_m / spec.pair.camera.gsd_m
    pair = []
    for side in (-1.0, 1.0):
        eye = _offset(T, (side * half, 0.0, 0.0))
        if spec.pair.axes == "toed_in":
            pair.append(_camera(spec.pair.camera, focal, _towards(T, eye, target)))
            continue
        pose = T.copy()
        pose[:3, 3] = eye
        shift = side * focal * half / where.distance_m if spec.pair.axes == "shifted" else 0.0
        pair.append(_camera(spec.pair.camera, focal, pose, shift))
    if spec.colour is None:
        return Calibration(pair[0], pair[1], None)
    eye = _offset(T, spec.colour.offset_m)
    focal = where.distance_m / spec.colour.camera.gsd_m
    return Calibration(
        pair[0], pair[1], _camera(spec.colour.camera, focal, _towards(T, eye, target))
    )


def _camera(kind: CameraSpec, focal: float, T: Array, shift_px: float = 0.0) -> Camera:
    centre = (kind.width - 1) / 2 + shift_px, (kind.height - 1) / 2
    K = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    return camera_from_K(K, kind.width, kind.height, T, np.array(kind.distortion))


def _true(
    spec: RigSpec, nominal: list[Calibration], error: CalibrationError, seed: int
) -> tuple[list[Calibration], tuple[float, ...], int]:
    """Draw until every unit can be matched along its rows."""
    best = np.inf
    for attempt in range(MAX_DRAWS):
        rng = stream(seed, "scanner", 0, attempt, "calibration")
        true = [perturbed(calibration, error, rng=rng) for calibration in nominal]
        rms = tuple(
            epipolar_rms_px(t, n, spec.volume_m) for t, n in zip(true, nominal, strict=True)
        )
        if max(rms) <= error.epipolar_limit_px:
            return true, rms, attempt + 1
        best = min(best, max(rms))
    rows = int(np.ceil(best / TOLERATED_PX_PER_ROW)) + 1
    raise ConfigError(
        f"none of {MAX_DRAWS} calibration draws has an epipolar RMS within "
        f"error.epipolar_limit_px = {error.epipolar_limit_px:g} px in every unit; the best has "
        f"{best:.2f} px, and rows that do not correspond cannot be matched: lower the sigmas "
        "under `error`"
        + (
            f", or set `reconstruction.rows: {rows}` (matcher sgbm), so that points are looked "
            "for over neighbouring rows"
            if rows <= MAX_ROWS
            else ""
        )
    )


def _projectors(spec: RigSpec, seed: int, folder: Path) -> tuple[Projector, ...]:
    poses: list[tuple[str, Array, PlaceSpec]] = []
    for ident, where in spec.units.items():
        T, target = place(where), np.array(where.target_m)
        for k, offset in enumerate(spec.unit_projectors_m):
            poses.append((f"{ident}/{k}", _towards(T, _offset(T, offset), target), where))
    poses += [(ident, place(where), where) for ident, where in spec.projectors.items()]
    both = sorted(set(spec.units) & set(spec.projectors))
    if both:
        raise ConfigError(f"id {both[0]!r} names a unit and a projector; ids must not overlap")
    if not 0 < len(poses) <= MAX_PROJECTORS:
        raise ConfigError(
            f"the rig has {len(poses)} projectors; 1 to {MAX_PROJECTORS} are possible: see "
            "`unit_projectors_m` and `projectors`"
        )
    return tuple(_projector(spec, seed, folder, k, *pose) for k, pose in enumerate(poses))


def _projector(
    spec: RigSpec, seed: int, folder: Path, k: int, ident: str, T: Array, where: PlaceSpec
) -> Projector:
    optics, pattern = spec.projector, spec.projector.pattern
    distance = float(np.linalg.norm(T[:3, 3] - np.array(where.target_m)))
    texel = pattern.dot_m / TEXELS_PER_DOT
    n = round(optics.field_m / texel)
    if n > MAX_SLIDE_PX:
        raise ConfigError(
            f"projector {ident}: field_m {optics.field_m:g} with dots of {pattern.dot_m:g} m needs "
            f"a slide of {n} texels; at most {MAX_SLIDE_PX}: larger dots or a smaller field"
        )
    K = np.array(
        [[distance / texel, 0, (n - 1) / 2], [0, distance / texel, (n - 1) / 2], [0, 0, 1]]
    )
    slide = Pattern(
        pattern.kind,
        TEXELS_PER_DOT,
        pattern.fill,
        _slide_seed(seed, k % pattern.slides),
        _slide_path(spec, folder),
    )
    return Projector(
        ident=ident,
        optics=camera_from_K(K, n, n, T),
        pattern=slide,
        irradiance=optics.irradiance,
        focus_m=distance + optics.focus_offset_m,
        aperture_m=optics.aperture_m,
        vignetting=optics.vignetting,
        slot=where.slot,
    )


def _slide_seed(seed: int, slide: int) -> int:
    rng: Any = stream(seed, "scanner", slide, 0, "slide")
    return int(rng.integers(2**62))
