"""How the true cameras of a scanner differ from the nominal ones, and what that does to matching.

Errors are independent per camera. A real bundle adjustment leaves correlated ones, which harm
less: independent sigmas exaggerate.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.cameras import Camera, project, undistort
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.scanner.rig import Calibration, CalibrationError, Vec3

Array = NDArray[np.float64]


def perturbed(
    nominal: Calibration, error: CalibrationError, *, rng: np.random.Generator
) -> Calibration:
    """Draw the true calibration of one unit."""
    turn = matrix_from_axis_angle(error.unit_rotation_rad * rng.standard_normal(3))
    shift = error.unit_translation_m * rng.standard_normal(3)

    def draw(camera: Camera) -> Camera:
        T = camera.T
        T[:3, 3] = turn @ T[:3, 3] + shift + error.translation_m * rng.standard_normal(3)
        T[:3, :3] = (
            turn @ T[:3, :3] @ matrix_from_axis_angle(error.rotation_rad * rng.standard_normal(3))
        )
        focal = 1 + error.focal * rng.standard_normal()
        cx, cy = error.principal_px * rng.standard_normal(2)
        k1, k2, p1, p2, k3 = camera.distortion
        return replace(
            camera,
            fx=camera.fx * focal,
            fy=camera.fy * focal,
            cx=camera.cx + float(cx),
            cy=camera.cy + float(cy),
            distortion=(k1 + float(error.k1 * rng.standard_normal()), k2, p1, p2, k3),
            T_world_from_camera=tuple(tuple(float(v) for v in row) for row in T),
        )

    colour = nominal.colour
    left, right = draw(nominal.left), draw(nominal.right)
    return Calibration(left, right, None if colour is None else draw(colour))


def rectifying_rotation(left: Camera, right: Camera) -> Array:
    """Return the rotation (3, 3) whose columns are the axes of the rectified pair, world.

    x runs along the baseline, z as near as it can to the mean of both optical axes.
    """
    x = right.position - left.position
    x = x / np.linalg.norm(x)
    z = left.T[:3, 2] + right.T[:3, 2]
    z = z - x * (z @ x)
    z = z / np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def volume_points(volume_m: Vec3, per_edge: int = 5) -> Array:
    """Return a lattice (n, 3) over the working volume, faces included, metres."""
    axes = [np.linspace(-0.5, 0.5, per_edge) * edge for edge in volume_m]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def in_frame(camera: Camera, points: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which world points (n, 3) a camera has in its picture, (n,)."""
    pixels, z = project(camera, points)
    size = np.array([camera.width, camera.height])
    return np.asarray((z > 0) & ((pixels > -0.5) & (pixels < size - 0.5)).all(axis=-1))


def epipolar_rms_px(true: Calibration, nominal: Calibration, volume_m: Vec3) -> float:
    """Return the RMS vertical mismatch of a pair rectified with its nominal calibration, pixels.

    Over a lattice in the working volume, where both cameras see it; 0 where they see none of it.
    Without glass: what that adds is known, see :func:`synthgen.scanner.rows.refracted_rows`.
    """
    points = volume_points(volume_m, 7)
    points = points[in_frame(nominal.left, points) & in_frame(nominal.right, points)]
    if not len(points):
        return 0.0
    rotation = rectifying_rotation(nominal.left, nominal.right)
    heights = []
    for real, known in ((true.left, nominal.left), (true.right, nominal.right)):
        pixels, _ = project(real, points)
        flat = undistort(known, (pixels - [known.cx, known.cy]) / [known.fx, known.fy])
        rays = np.concatenate([flat, np.ones((len(flat), 1))], axis=1) @ known.T[:3, :3].T
        level = rays @ rotation
        heights.append(level[:, 1] / level[:, 2] * nominal.left.fy)
    return float(np.sqrt(np.mean((heights[0] - heights[1]) ** 2)))
