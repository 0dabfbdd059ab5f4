"""Orientation of the hand as the camera sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import SamplingError

# Hand frame (right): fingers -x, palm -y, thumb +z. Camera: x right, y down, z forward.
# Back of the hand to the camera, fingers up: -x_hand -> -y_cam, +y_hand -> -z_cam.
BACK_TO_CAMERA: NDArray[np.float64] = np.array(
    [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
)


def uniform_rotation(*, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a rotation matrix from the Haar measure on SO(3).

    A normalised 4-D Gaussian is a uniform unit quaternion (Shoemake 1992).

    Returns
    -------
    (3, 3) float64
    """
    w, x, y, z = (q := rng.standard_normal(4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def cone_rotation(cone_deg: float, *, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a rotation whose dorsal axis lies within a cone about the direction to the camera.

    The axis is uniform over the cap's solid angle and the roll about the optical axis uniform.

    Parameters
    ----------
    cone_deg : float
        Half angle, degrees, in (0, 180]; 180 gives the uniform distribution on SO(3).

    Returns
    -------
    (3, 3) float64
        ``R_camera_from_hand`` of a right hand.
    """
    if not 0 < cone_deg <= 180:
        raise SamplingError(f"orientation.cone_deg={cone_deg}: allowed is 0 < cone_deg <= 180")
    cos_tilt = 1 - rng.random() * (1 - np.cos(np.deg2rad(cone_deg)))
    tilt = np.arccos(cos_tilt)
    roll, azimuth = rng.uniform(0, 2 * np.pi, 2)
    lean = _rot_z(azimuth) @ _rot_x(tilt) @ _rot_z(-azimuth)
    return np.asarray(_rot_z(roll) @ lean @ BACK_TO_CAMERA, dtype=np.float64)


def mirror_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``M R M`` with M = diag(-1, 1, 1): what a mirrored hand does in a mirrored view."""
    sign = np.array([-1.0, 1.0, 1.0])
    return np.asarray(rotation * sign[:, None] * sign[None, :], dtype=np.float64)


def _rot_x(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rot_z(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
