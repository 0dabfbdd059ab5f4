"""What a consumer depth camera reports of a scene, on the pixels of a given view.

The device is the one-unit rig ``consumer``: its left camera stands where the view's camera does and
has its field of view, so that colour and depth see the same. Everything else is the device's own:
pixels per angle, baseline, projector, sensors, calibration errors, census matching with its limited
disparities, and with them its nearest depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ConfigError
from synthgen.geometry.cameras import Camera, undistort
from synthgen.geometry.transforms import invert
from synthgen.sampling.streams import stream
from synthgen.scanner.calibration import perturbed
from synthgen.scanner.census import match_census
from synthgen.scanner.exposure import expose
from synthgen.scanner.ideal import ideal_disparity
from synthgen.scanner.match import DisparityGrid
from synthgen.scanner.noise import add_noise, load_noise, strength_on
from synthgen.scanner.rectify import Rectified
from synthgen.scanner.rig import Calibration, Rig, Unit
from synthgen.scanner.scaling import scale_camera, scaled
from synthgen.scanner.settings import check_level
from synthgen.scanner.stage import Effects, prepare
from synthgen.scanner.subject import ScanScene, placed

DepthLevel = Literal["full", "half", "model"]
_LARGEST_DISPARITY = 126
# Islands of fewer pixels, more than a pixel of disparity from their surroundings, are dropped.
_ISLAND_PX = 40
_NEAREST_M, _FARTHEST_M = 0.15, 10.0
# Skin blurs by less than these cameras' pixels.
_EFFECTS = Effects(subsurface=False, bounce=False)
# No working volume limits a device that is carried about.
_ANYWHERE = (100.0, 100.0, 100.0)


@dataclass(frozen=True, eq=False)
class SensorDepth:
    """A depth picture.

    Attributes
    ----------
    depth_z_m : (H, W) float32
        Along the view's optical axis, metres; 0 where nothing was measured.
    problem : str or None
        Why nothing could be measured.
    """

    depth_z_m: NDArray[np.float32]
    problem: str | None


def sense_depth(
    scene: ScanScene, camera: Camera, rig: Rig, *, rng: np.random.Generator,
    level: DepthLevel = "full",
) -> SensorDepth:  # fmt: skip
    """Measure the depth of a scene from a camera's place.

    Parameters
    ----------
    scene : ScanScene
        World of the camera, metres.
    camera : Camera
        The view whose pixels are wanted.
    rig : Rig
        A device of one unit with parallel axes, such as ``consumer``.
    level : {"full", "half", "model"}
        Dot pictures and census matching; with half the pixels along each edge; or ideal disparities
        with the noise model that was fitted to full ones.

    Raises
    ------
    ConfigError
        If the rig is no such device, or there is no such level.
    """
    check_level(level)
    device = device_for(rig, camera)
    device = scaled(device, 0.5) if level == "half" else device
    unit = device.units[0]
    T = unit.nominal.left.T @ invert(camera.T)
    stage = prepare(placed(scene, T), device, rng=rng, effects=_EFFECTS)
    pair = _pair(unit)
    problem = None
    if level != "model":
        shot = expose(stage, unit)
        scale = 255 / device.grey.full_scale
        problem = shot.problem
        grid = _tidied(match_census(shot.left * scale, shot.right * scale, _bounds(pair)))
    else:
        ideal = ideal_disparity(stage, unit, pair, 1, time_s=0.0)
        noise = stream(stage.key, "sample", 0, 0, "matching")
        shape = pair.camera.height, pair.camera.width
        model = load_noise("consumer")
        strength = strength_on(scene.solids, model)
        grid = add_noise(ideal, 1, shape, model, rng=noise, strength=strength)
    depth = _on_view(pair, grid, camera)
    return SensorDepth(depth if problem is None else np.zeros_like(depth), problem)


def device_for(rig: Rig, camera: Camera) -> Rig:
    """Return the device with the field of view of a camera.

    The device keeps its focal length in pixels (what decides its nearest depth and its errors), its
    place in its own frame, its projector, and its calibration errors, which are the frozen draw of
    the rig's seed.
    """
    if len(rig.units) != 1 or rig.units[0].nominal.left.T[:3, :3].tolist() != (
        rig.units[0].nominal.right.T[:3, :3].tolist()
    ):
        raise ConfigError(
            f"rig {rig.name} is no depth camera: that takes one unit with `axes: parallel`, as in "
            "the rig consumer"
        )
    unit = rig.units[0]
    left, right = (_with_field(c, camera) for c in (unit.nominal.left, unit.nominal.right))
    nominal = Calibration(left, right, None)
    rng = stream(rig.seed, "scanner", 0, rig.draws - 1, "calibration")
    true = perturbed(nominal, rig.error, rng=rng)
    return replace(rig, units=(replace(unit, nominal=nominal, true=true),), volume_m=_ANYWHERE)


def _with_field(own: Camera, view: Camera) -> Camera:
    """Return the device's camera with the view's field and no distortion."""
    field = scale_camera(view, own.fx / view.fx)
    return replace(
        field, fy=field.fx, distortion=(0.0,) * 5, T_world_from_camera=own.T_world_from_camera
    )


def _pair(unit: Unit) -> Rectified:
    """Return the pair as the device believes it to be: parallel, its pictures need no warp."""
    left, right = unit.nominal.left, unit.nominal.right
    baseline = float(np.linalg.norm(right.position - left.position))
    return Rectified(left, right, left, right.cx, baseline)


def _bounds(pair: Rectified) -> tuple[float, float]:
    nearest = min(float(pair.disparity(_NEAREST_M)), float(_LARGEST_DISPARITY))
    return min(float(pair.disparity(_FARTHEST_M)), nearest - 1), nearest


def _tidied(grid: DisparityGrid) -> DisparityGrid:
    """Forget islands of a few pixels, as hosts of such cameras do."""
    steps = np.where(np.isfinite(grid.disparity), grid.disparity * 16, -1600).astype(np.int16)
    kept, _ = cv2.filterSpeckles(steps, -1600, _ISLAND_PX, 16)
    return replace(grid, disparity=np.where(kept > -1600, grid.disparity, np.float32(np.nan)))


def _on_view(pair: Rectified, grid: DisparityGrid, camera: Camera) -> NDArray[np.float32]:
    """Take the nearest measurement for every pixel of the view; 0 where there is none."""
    y, x = np.mgrid[: camera.height, : camera.width].reshape(2, -1).astype(np.float64)
    flat = (np.stack([x, y], axis=1) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    own = pair.camera
    at = undistort(camera, flat) * [own.fx, own.fy] + [own.cx, own.cy]
    column, row = np.floor(at + 0.5).astype(np.int64).T
    inside = (column >= 0) & (column < own.width) & (row >= 0) & (row < own.height)
    disparity = np.full(len(at), np.nan)
    disparity[inside] = grid.disparity[row[inside], column[inside]]
    far_enough = disparity + pair.offset_px > own.fx * pair.baseline_m / _FARTHEST_M
    depth = np.where(far_enough, pair.depth(np.where(far_enough, disparity, 1.0)), 0.0)
    return depth.reshape(camera.height, camera.width).astype(np.float32)
