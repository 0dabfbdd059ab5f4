"""How the picture is taken: lens distortion, depth of field, motion, sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from synthgen.config.places import OpticsSettings, SensorSettings
from synthgen.errors import ShapeError
from synthgen.geometry.cameras import Camera, project, to_camera, undistort
from synthgen.sampling.appearance import rounded
from synthgen.scene import Motion, Optics, Sensor

Array = NDArray[np.float64]

SUB_FRAMES = 4
# Lenses are inverted with this much more distortion than they keep; what fails is weakened.
_MARGIN, _WEAKER = 1.15, 0.8


def distorted(
    cameras: tuple[Camera, ...], largest: float, end: Array, *, rng: np.random.Generator
) -> tuple[Camera, ...]:
    """Give every camera the same lens's distortion: the corner moves by up to ``largest``.

    A lens that would fold the picture over before its corner, or bring the arm's open end
    (``end`` (E, 3), world) into it, is weakened until it does not.
    """
    moved, tangential = rng.uniform(-largest, largest), rng.normal(0, 0.1, 2) * largest
    if largest == 0:
        return cameras
    share = 1.0
    while True:
        bent = tuple(_bent(camera, share * moved, share * tangential) for camera in cameras)
        if all(_unfolded(camera) and not _shown(camera, end) for camera in bent):
            return bent
        share *= _WEAKER


def _bent(camera: Camera, moved: float, tangential: Array) -> Camera:
    corner = ((camera.width / 2) ** 2 + (camera.height / 2) ** 2) / camera.fx**2
    k1 = round(float(moved / corner), 9)
    p1, p2 = (round(float(v / np.sqrt(corner)), 9) for v in tangential)
    return replace(camera, distortion=(k1, 0.0, p1, p2, 0.0))


def _unfolded(camera: Camera) -> bool:
    """Tell whether a lens can be inverted over its frame, with some margin."""
    u = (np.linspace(-0.5, camera.width - 0.5, 9) - camera.cx) / camera.fx
    v = (np.linspace(-0.5, camera.height - 0.5, 9) - camera.cy) / camera.fy
    k1, _, p1, p2, _ = camera.distortion
    stronger = (_MARGIN * k1, 0.0, _MARGIN * p1, _MARGIN * p2, 0.0)
    try:
        undistort(replace(camera, distortion=stronger), np.stack(np.meshgrid(u, v), axis=-1))
    except ShapeError:
        return False
    return True


def _shown(camera: Camera, points: Array) -> bool:
    """Tell whether some of the points (n, 3), world, lie in the picture."""
    pixels, z = project(camera, points)
    size = np.array([camera.width, camera.height]) - 0.5
    within = np.all((pixels > -0.5) & (pixels < size), axis=-1) & (z > 1e-3)
    pixels, local = pixels[within], to_camera(camera, points[within])
    # What lies far aside may be thrown back into the frame: no ray of the picture goes there.
    flat = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    seen = undistort(camera, flat) - local[:, :2] / local[:, 2:]
    return bool((np.abs(seen).max(axis=1, initial=0.0) < 1e-6).any())


def sample_optics(
    settings: OpticsSettings, cameras: tuple[Camera, ...], hand: Array, *, rng: np.random.Generator
) -> tuple[Optics, ...]:
    """Draw the aperture: shallow depth of field in a share of samples, focus on the hand.

    The blur of a point at twice the hand's distance is 0.8 to 3 % of the frame's width.
    """
    shallow, blur = rng.random() < settings.defocus, rng.uniform(0.008, 0.03)
    if settings.defocus == 0:
        return ()
    done = []
    for camera in cameras:
        z = (hand - camera.position) @ camera.T[:3, 2]
        focus = float(np.quantile(z, 0.35))
        # Diameter of blur in pixels: 2 a f (1/focus - 1/z); z twice the focus.
        radius = blur * camera.width * focus / camera.fx if shallow else 0.0
        done.append(Optics(round(float(radius), 6), round(focus, 6)))
    return tuple(done)


def sample_motion(
    settings: OpticsSettings, camera: Camera, hand: Array, *, rng: np.random.Generator
) -> Motion | None:
    """Draw a rigid motion of the hand and its arm during the exposure, or None."""
    moving, length = rng.random() < settings.motion, rng.uniform(*settings.motion_px)
    direction, turn = rng.standard_normal(3), rng.standard_normal(3)
    if not moving:
        return None
    centre = hand.mean(axis=0)
    distance = float((centre - camera.position) @ camera.T[:3, 2])
    metres = length * camera.width / 256 * distance / camera.fx
    shift = direction / np.linalg.norm(direction) * metres * 0.7
    angle = turn / np.linalg.norm(turn) * metres / 0.09 * 0.5  # at a fingertip, 9 cm away
    return Motion(rounded(centre), rounded(shift), rounded(angle), SUB_FRAMES)


def sample_sensor(settings: SensorSettings, *, rng: np.random.Generator) -> Sensor:
    """Draw one camera's sensor; every number takes its draw whether it is used or not."""
    exposure, balance = rng.standard_normal(), rng.standard_normal(3)
    psf, well, sharpen = rng.uniform(*settings.psf_px), rng.random(), rng.random()
    low, high = settings.jpeg
    quality, seed = int(rng.integers(low, high + 1)), int(rng.integers(2**31))
    full_well = 0.0
    if settings.full_well[0] > 0:
        ends = np.log(settings.full_well)
        full_well = round(float(np.exp(ends[0] + well * (ends[1] - ends[0]))), 1)
    return Sensor(
        exposure_ev=round(float(settings.exposure_ev * np.clip(exposure, -2.5, 2.5)), 6),
        white_balance=settings.white_balance,
        balance_error=rounded(np.exp(settings.balance_error * balance)),
        psf_px=round(float(psf), 6),
        full_well=full_well,
        read_e=settings.read_e,
        bayer=settings.bayer,
        sharpen=round(float(settings.sharpen * sharpen), 6),
        bloom=settings.bloom,
        jpeg_quality=quality,
        seed=seed,
    )
