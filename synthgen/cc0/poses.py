"""The versioned pose table behind ``hands_mean``, ``hands_components`` and ``hands_coeffs``.

Drawn by the joint-limit sampler with correlated fingers; the poses of capture protocols stay out
of it, so that they can test what was trained on it. Authored ranges, not measured hands.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthgen.sampling.limits import JointLimits, couple, from_angles

Array = NDArray[np.float64]

VERSION = 1
# How alike neighbouring fingers curl (Gaussian copula); pinky order in MANO: 1 4 7 10 13.
_CURL_CORRELATION = 0.85
_MCP = (1, 4, 10, 7)  # index, middle, ring, pinky: neighbours in the hand


def pose_table(limits: JointLimits, n: int, *, rng: np.random.Generator) -> Array:
    """Draw n hand poses (n, 16, 3), root zero, within the limits.

    Fingers curl together with a correlation that falls with their distance; MCP and PIP joints of
    a finger share part of the curl; the thumb opposes more when the fingers are curled.
    """
    low, high = limits.range[..., 0], limits.range[..., 1]
    angles = low + (high - low) * rng.beta(5, 5, (n, 16, 3))
    curl = _neighbours(n, rng)
    for column, mcp in enumerate(_MCP):
        own = curl[:, column]
        for joint, share in ((mcp, 0.6), (mcp + 1, 0.85)):
            level = share * own + np.sqrt(1 - share**2) * rng.standard_normal(n)
            angles[:, joint, 0] = _bend(level, limits.range[joint, 0])
        angles[:, mcp, 1] = _spread(n, limits.range[mcp, 1], rng)
    together = curl.mean(axis=1)
    for k, share in ((0, 0.35), (1, 0.25), (2, 0.25)):
        level = share * together + np.sqrt(1 - share**2) * rng.standard_normal(n)
        angles[:, 13, k] = _bend(0.8 * level, limits.range[13, k])
    for joint in (14, 15):
        angles[:, joint, 0] = _bend(rng.standard_normal(n) - 0.3, limits.range[joint, 0])
    return from_angles(limits, couple(limits, angles, rng=rng))


def _neighbours(n: int, rng: np.random.Generator) -> Array:
    distance = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    covariance = _CURL_CORRELATION**distance
    return rng.standard_normal((n, 4)) @ np.linalg.cholesky(covariance).T


def _bend(level: Array, bounds: Array) -> Array:
    """Map a standard normal level to an angle: relaxed in the middle, limits at the ends."""
    share = 1 / (1 + np.exp(-1.35 * (level - 0.25)))
    return np.asarray(bounds[0] + (bounds[1] - bounds[0]) * share)


def _spread(n: int, bounds: Array, rng: np.random.Generator) -> Array:
    return np.asarray(bounds[0] + (bounds[1] - bounds[0]) * rng.beta(2.5, 3.5, n))


def single_joint_poses(limits: JointLimits) -> Array:
    """Poses that move one joint alone to 90 per cent of each end of each of its ranges."""
    rows = []
    for joint in range(1, 16):
        for axis in range(3):
            for end in (0, 1):
                reach = 0.9 * limits.range[joint, axis, end]
                if abs(reach) > np.deg2rad(12):
                    angles = np.zeros((16, 3))
                    angles[joint, axis] = reach
                    rows.append(angles)
    return from_angles(limits, np.array(rows))


# Protocol poses (degrees: MCP, PIP, DIP of index, middle, ring, pinky; thumb CMC flexion and
# abduction, MCP, IP) by their usual names; used to test only.
# fmt: off
_PROTOCOL: dict[str, tuple[tuple[int, int, int], ...]] = {
    "fist": ((85, 98, 60), (86, 98, 60), (86, 98, 60), (85, 95, 60), (35, 25, 35), (45, 0, 0)),
    "tabletop": ((85, 3, 2), (85, 3, 2), (85, 3, 2), (85, 3, 2), (0, 10, 0), (0, 0, 0)),
    "hook": ((0, 95, 60), (0, 95, 60), (0, 95, 60), (0, 95, 60), (0, 5, 0), (0, 0, 0)),
    "point": ((0, 5, 2), (80, 95, 55), (82, 95, 55), (82, 90, 50), (35, 25, 30), (40, 0, 0)),
    "large diameter": (
        (25, 40, 20), (28, 42, 22), (30, 42, 22), (30, 40, 20), (12, 40, 15), (20, 0, 0),
    ),
    "medium wrap": (
        (50, 65, 35), (55, 70, 38), (58, 70, 38), (60, 65, 35), (25, 42, 20), (30, 0, 0),
    ),
    "lateral": ((50, 65, 35), (55, 75, 40), (60, 80, 42), (62, 80, 42), (20, 8, 15), (35, 0, 0)),
    "tripod": ((45, 40, 22), (50, 42, 22), (30, 30, 15), (25, 25, 12), (28, 42, 10), (18, 0, 0)),
    "power sphere": (
        (25, 45, 30), (28, 45, 30), (30, 45, 30), (30, 42, 28), (12, 42, 15), (25, 0, 0),
    ),
    "parallel extension": ((55, 8, 2), (58, 8, 2), (58, 8, 2), (55, 8, 2), (25, 40, 2), (0, 0, 0)),
}
# fmt: on


def protocol_poses(limits: JointLimits) -> tuple[tuple[str, ...], Array]:
    """Return names and poses (n, 16, 3) of the test protocol, within the limits."""
    angles = np.zeros((len(_PROTOCOL), 16, 3))
    for row, fingers in zip(angles, _PROTOCOL.values(), strict=True):
        for mcp, bend in zip(_MCP, fingers[:4], strict=True):
            row[mcp : mcp + 3, 0] = np.deg2rad(bend)
        flexion, abduction, mcp_bend = fingers[4]
        row[13, :2] = np.deg2rad([flexion, abduction])
        row[14, 0], row[15, 0] = np.deg2rad(mcp_bend), np.deg2rad(fingers[5][0])
    angles = np.clip(angles, limits.range[..., 0], limits.range[..., 1])
    return tuple(_PROTOCOL), from_angles(limits, angles)
