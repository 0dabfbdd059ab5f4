"""Where the hand stands, how its arm leaves the picture, and where the cameras look from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import SamplingError
from synthgen.geometry.cameras import Camera
from synthgen.scene.description import Vec3

Array = NDArray[np.float64]

# Limits of the wrist of the forearm relative to the hand, degrees: flexion, deviation, twist.
WRIST_DEG = np.array([35.0, 15.0, 25.0])
ELBOW_DEG = (10.0, 120.0)
ARM_TRIES = 32
# No part of the arm comes nearer to a camera than this, metres.
NEAREST_ARM_M = 0.06


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a camera that has no place yet: pixels, and the field of view it came from."""

    width: int
    height: int
    focal_px: float
    fov_deg: float

    def camera(self, T_world_from_camera: Array) -> Camera:
        """Put the lens at ``T_world_from_camera`` (4, 4), OpenCV axes."""
        return Camera(
            width=self.width,
            height=self.height,
            fx=self.focal_px,
            fy=self.focal_px,
            cx=self.width / 2 - 0.5,
            cy=self.height / 2 - 0.5,
            distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
            T_world_from_camera=tuple(tuple(float(v) for v in row) for row in T_world_from_camera),
        )


def sample_lens(
    width: int, height: int, fov_deg: tuple[float, float], *, rng: np.random.Generator
) -> Lens:
    """Draw a field of view, uniform in degrees over the longer side of the frame."""
    fov = float(rng.uniform(*fov_deg))
    return Lens(width, height, max(width, height) / 2 / np.tan(np.deg2rad(fov) / 2), fov)


def sample_view(*, rng: np.random.Generator) -> Array:
    """Draw the camera's rotation ``R_world_from_camera`` (3, 3).

    Azimuth uniform, elevation -20 to 65 degrees above the horizon, roll within 15 degrees.
    """
    azimuth = rng.uniform(0, 2 * np.pi)
    elevation = np.deg2rad(rng.uniform(-20, 65))
    roll = np.deg2rad(rng.uniform(-15, 15))
    forward = -np.array(
        [
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
            np.cos(elevation) * np.cos(azimuth),
        ]
    )
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=1)


def camera_position(
    points: Array, lens: Lens, fill: float, offset: Array, view: Array
) -> tuple[Array, float]:
    """Place a camera so that points fill a given share of the frame's shorter side.

    Parameters
    ----------
    points : (n, 3)
        World points of the hand, metres.
    lens : Lens
    fill : float
        Larger side of the points' bounding box over the shorter side of the frame.
    offset : (2,)
        Where the box's centre goes, from the image centre, as a share of the frame.
    view : (3, 3)
        ``R_world_from_camera``.

    Returns
    -------
    T_world_from_camera : (4, 4)
    distance_m : float
        From the camera to the points' centre along the optical axis.
    """
    local = points @ view
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    local = np.asfortranarray(local - middle)
    want = fill * min(lens.width, lens.height)
    near = max(0.12, -local[:, 2].min() + 0.08)
    low, high = near, 20.0
    for _ in range(60):
        distance = (low + high) / 2
        low, high = (distance, high) if _span(local, distance, lens) > want else (low, distance)
    distance = (low + high) / 2
    shift = _centre(local, distance, lens) - offset * [lens.width, lens.height]
    back = np.array([*(shift * distance / lens.focal_px), -distance])
    transform = np.eye(4)
    transform[:3, :3] = view
    transform[:3, 3] = view @ (middle + back)
    return transform, float(distance)


def _span(local: Array, distance: float, lens: Lens) -> float:
    x, y = local[:, 0] / (local[:, 2] + distance), local[:, 1] / (local[:, 2] + distance)
    return float(lens.focal_px * max(x.max() - x.min(), y.max() - y.min()))


def _centre(local: Array, distance: float, lens: Lens) -> Array:
    pixels = lens.focal_px * local[:, :2] / (local[:, 2:] + distance)
    return np.asarray((pixels.min(axis=0) + pixels.max(axis=0)) / 2)


def sample_arm(*, rng: np.random.Generator) -> tuple[Vec3, Vec3]:
    """Draw the angles of the arm behind the hand.

    Returns
    -------
    wrist : Vec3
        Axis-angle of the forearm relative to the hand; flexion about z, deviation about y, twist
        about x, each triangular around zero within +-35, +-15 and +-25 degrees.
    elbow : Vec3
        Axis-angle of the upper arm relative to the forearm: 10 to 120 degrees about any axis
        across the forearm (the hinge turns with pronation).
    """
    twist_last = rng.triangular(-1, 0, 1, 3) * np.deg2rad(WRIST_DEG)
    bend = np.deg2rad(rng.uniform(*ELBOW_DEG))
    around = rng.uniform(0, 2 * np.pi)
    wrist = (float(twist_last[2]), float(twist_last[1]), float(twist_last[0]))
    return wrist, (0.0, float(bend * np.cos(around)), float(bend * np.sin(around)))


def arm_leaves_frame(end: Array, arm: Array, cameras: tuple[Camera, ...]) -> bool:
    """Tell whether an arm's open end is out of every picture and no part of it too near.

    Parameters
    ----------
    end : (E, 3)
        Vertices of the open end, world, metres.
    arm : (A, 3)
        All arm vertices, world, metres.
    cameras : tuple of Camera
    """
    return all(_leaves(end, arm, camera) for camera in cameras)


def _leaves(end: Array, arm: Array, camera: Camera) -> bool:
    T = np.asarray(camera.T_world_from_camera)
    inside = _in_frame((end - T[:3, 3]) @ T[:3, :3], camera)
    too_near = np.linalg.norm(arm - T[:3, 3], axis=1).min() < NEAREST_ARM_M
    return bool(not inside.any() and not too_near)


def _in_frame(local: Array, camera: Camera, margin: float = 0.02) -> NDArray[np.bool_]:
    z = local[:, 2]
    safe = np.where(z > 1e-3, z, 1.0)
    x = camera.fx * local[:, 0] / safe + camera.cx
    y = camera.fy * local[:, 1] / safe + camera.cy
    border = margin * max(camera.width, camera.height)
    inside = (x > -border) & (x < camera.width + border)
    return inside & (y > -border) & (y < camera.height + border) & (z > 1e-3)


def depth_behind(points: Array, camera: Camera) -> float:
    """Return how far points reach along the optical axis, metres from the camera."""
    T = np.asarray(camera.T_world_from_camera)
    return float(((points - T[:3, 3]) @ T[:3, 2]).max())


def require_arm(found: object | None, index: int, tries: int) -> None:
    """Raise where no arm left the picture.

    Raises
    ------
    SamplingError
    """
    if found is None:
        raise SamplingError(
            f"sample {index}: in {tries} placements the arm's open end stayed in the picture; "
            "raise camera.fill or narrow camera.fov_deg"
        )
