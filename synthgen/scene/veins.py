"""Where the veins of the back of the hand run: a net of lines over the rest pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from synthgen.geometry.nearest import nearest

if TYPE_CHECKING:
    from synthgen.scene.anatomy import Anatomy

Array = NDArray[np.float64]

_RADIUS_M = 0.0016
_REACH_M = 0.006
_STEP_M = 0.0004


def vein_field(
    points: NDArray[Any], normals: NDArray[Any], weights: NDArray[Any], anatomy: Anatomy
) -> Array:
    """Return how much of a vein lies under each place of the skin: (n,) in 0..1.

    Both the drawn relief and the skin's colour read this one function, so they agree.

    Parameters
    ----------
    points, normals : (n, 3)
        Rest pose, right hand's frame.
    weights : (n, 17)
        Skinning weights, the arm's last.
    anatomy : Anatomy
    """
    plan = np.asarray(points, np.float64)[:, [0, 2]]
    net, gain = _net(anatomy)
    away, index = nearest(net, plan, _REACH_M)
    found = np.isfinite(away)
    strength = np.zeros(len(plan))
    strength[found] = gain[index[found]] * np.exp(-((away[found] / _RADIUS_M) ** 2))
    fingers = np.stack([weights[:, 1 + 3 * f : 4 + 3 * f].sum(axis=1) for f in range(5)]).max(
        axis=0
    )
    dorsal = np.clip((normals[:, 1] - 0.2) / 0.5, 0, 1) * np.clip((0.75 - fingers) / 0.4, 0, 1)
    return np.asarray(strength * dorsal)


def _net(anatomy: Anatomy) -> tuple[Array, Array]:
    """Points (m, 2) along every vein, and the vein's strength there (m,)."""
    lines = _lines(anatomy)
    points = [curve(line, _STEP_M) for line, _ in lines]
    strength = [
        gain * (0.65 + 0.35 * np.sin(9.0 * np.linspace(0, 1, len(p)) + 3 * k))
        for k, (p, (_, gain)) in enumerate(zip(points, lines, strict=True))
    ]
    return np.concatenate(points), np.concatenate(strength)


def _lines(anatomy: Anatomy) -> list[tuple[Array, float]]:
    """Control points (x, z) of each vein and its strength."""
    knuckles = {f.name: f.points[0][[0, 2]] for f in anatomy.fingers}
    length = float(-knuckles["middle"][0])
    start = [
        0.97 * (knuckles[a] + knuckles[b]) / 2
        for a, b in (("index", "middle"), ("middle", "ring"), ("ring", "pinky"))
    ]
    node = [np.array([-s * length, z]) for s, z in ((0.62, 0.020), (0.54, 0.003), (0.58, -0.014))]
    end = [np.array([0.02 * length, 0.021]), np.array([0.05 * length, -0.012])]
    net = [
        (start[0], node[0], 1.0), (start[0], node[1], 0.7), (start[1], node[1], 1.0),
        (start[2], node[2], 1.0), (start[1], node[2], 0.6), (node[0], end[0], 1.0),
        (node[1], end[0], 0.8), (node[2], end[1], 1.0), (node[0], node[1], 0.6),
    ]  # fmt: skip
    lines = [(_wavy(a, b, k), gain) for k, (a, b, gain) in enumerate(net)]
    for k, (z0, z1) in enumerate(((0.020, 0.028), (-0.012, -0.018), (0.004, 0.0))):
        far = np.array([0.20, z1])
        lines.append((_wavy(np.array([0.01, z0]), far, 20 + k, 9), 0.8))
    return lines


def _wavy(a: Array, b: Array, number: int, count: int = 6) -> Array:
    """Control points from a to b that sway sideways by a fixed pattern."""
    t = np.linspace(0, 1, count)[:, None]
    side = np.array([[-(b - a)[1], (b - a)[0]]]) / max(float(np.linalg.norm(b - a)), 1e-9)
    sway = 0.0021 * np.sin(np.pi * t) * np.sin(5.1 * t * (1 + 0.3 * np.sin(number)) + 2.3 * number)
    return np.asarray(a + t * (b - a) + sway * side)


def curve(controls: NDArray[Any], step_m: float) -> Array:
    """Smooth curve (n, d) through control points (k, d), sampled about every ``step_m``."""
    points = np.asarray(controls, dtype=np.float64)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    t = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 1e-9))])
    count = max(int(t[-1] / step_m), 8)
    return np.asarray(CubicSpline(t, points)(np.linspace(0, t[-1], count)))
