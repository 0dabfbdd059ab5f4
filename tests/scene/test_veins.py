"""Veins: a net on the back of hand and forearm, none on fingers and palm."""

from __future__ import annotations

import numpy as np

from synthgen.models import load
from synthgen.scene.anatomy import anatomy_of
from synthgen.scene.veins import curve, vein_field


def test_reference_curve_passes_through_its_controls() -> None:
    controls = np.array([[0.0, 0.0], [0.01, 0.004], [0.03, 0.0], [0.05, -0.01]])
    line = curve(controls, 1e-4)
    nearest = np.linalg.norm(line[None] - controls[:, None], axis=2).min(axis=1)
    assert nearest.max() < 1e-4
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).max() < 2e-4


def test_properties_on_the_back_alone() -> None:
    a = anatomy_of(load("cc0-hand"))
    vein = vein_field(a.points, a.normals, a.weights, a)
    assert 0 <= vein.min() <= vein.max() <= 1
    assert vein.max() > 0.7
    assert vein[a.normals[:, 1] < 0.2].max() == 0
    fingers = np.stack([a.finger_weight(f) for f in range(5)]).max(axis=0)
    assert vein[fingers > 0.76].max() == 0
    covered = np.mean(vein[(a.normals[:, 1] > 0.6) & (a.weights[:, 0] > 0.9)] > 0.3)
    assert 0.05 < covered < 0.5
