"""Light through the slab, against Snell's law written out."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.scanner.glass import (
    normal_shift,
    seen_position,
    shifted_origins,
    thickness_for,
    transmittance,
)
from synthgen.scanner.rig import Glass

GLASS = Glass(top_m=-0.1, thickness_m=0.02, ior=1.52)


def through(eye: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Where a ray from below is on the upper face, refracted at both faces."""
    at = eye + way * ((GLASS.top_m - GLASS.thickness_m - eye[1]) / way[1])
    sine = np.hypot(way[0], way[2]) / np.linalg.norm(way)
    inside = np.arcsin(sine / GLASS.ior)
    aside = np.array([way[0], 0, way[2]])
    aside = aside / max(np.linalg.norm(aside), 1e-30)
    return at + aside * GLASS.thickness_m * np.tan(inside) + [0, GLASS.thickness_m, 0]


@pytest.mark.parametrize("slope", [0.0, 0.3, 1.0, 2.5])
def test_reference_snell(slope: float) -> None:
    eye, way = np.array([0.02, -0.7, 0.1]), np.array([0.8 * slope, 1.0, -0.6 * slope])
    way = way / np.linalg.norm(way)
    upper = through(eye, way)
    start = shifted_origins(GLASS, eye, way[None])[0]
    ours = start + way * ((GLASS.top_m - start[1]) / way[1])
    assert np.abs(ours - upper).max() < 1e-12
    # And back: from the point on the glass, where does the eye seem to be?
    point = upper + 0.05 * way
    assert np.abs(seen_position(GLASS, eye, point[None])[0] - start).max() < 1e-12


def test_reference_fresnel() -> None:
    r = ((1.52 - 1) / (1.52 + 1)) ** 2
    assert transmittance(1.0, 1.52) == pytest.approx((1 - r) / (1 + r))
    angles = np.cos(np.deg2rad([0, 30, 60, 85]))
    assert (np.diff(transmittance(angles, 1.52)) < 0).all()
    assert transmittance(0.5, 1.0) == pytest.approx(1)


def test_edge_no_glass_from_above() -> None:
    above = np.array([0.0, 0.4, 0.5])
    assert thickness_for(GLASS, above) == 0
    assert thickness_for(None, above) == 0
    way = np.array([[0.0, -1.0, 0.0]])
    assert np.array_equal(shifted_origins(GLASS, above, way), above[None])
    assert normal_shift(0.5, 0.0, 1.5) == 0
