"""Which keypoints count as visible, by what their rays hit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from synthgen.geometry.cameras import camera_from_K
from synthgen.models import load_hand
from synthgen.models.joints import OPENPOSE21_FROM_MANO21
from synthgen.render import visibility
from synthgen.render.labels import NOTHING, Hits
from synthgen.render.visibility import OCCLUDED, VISIBLE, label_hand
from synthgen.scene.surface import DrawnSurface

MODEL = load_hand("cc0-hand", hand="right")
CAMERA = camera_from_K(np.array([[300.0, 0, 99.5], [0, 300.0, 99.5], [0, 0, 1]]), 200, 200)
TIPS = [4, 8, 12, 16, 20]


def states(monkeypatch: pytest.MonkeyPatch, behind_m: float, solid: int) -> Any:
    """Label a hand whose rays all end that far behind the keypoints, on a part of the palm."""
    posed = MODEL.evaluate(np.zeros((1, MODEL.n_shape)), np.zeros((1, 16, 3)))
    both = np.concatenate([posed.joints[0], posed.vertices[0][MODEL.fingertip_ids]])
    keypoints = both[list(OPENPOSE21_FROM_MANO21)].astype(np.float64) + [0, 0, 0.6]
    away = np.linalg.norm(keypoints, axis=1)
    none = np.zeros(21, np.int64)
    hits = Hits(np.full(21, solid, np.int32), none, np.tile([1.0, 0, 0], (21, 1)),
                away + behind_m, np.zeros((21, 3)))  # fmt: skip
    monkeypatch.setattr(visibility, "trace", lambda *_: hits)
    live: Any = SimpleNamespace(models=[MODEL], drawn=[DrawnSurface.for_model(MODEL)])
    return label_hand(live, 0, keypoints, CAMERA).keypoints_state


def test_edge_a_ray_may_slip_past_a_fingertip(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is before a fingertip whose ray ends behind it: neither skin nor a wall hides it."""
    for solid in (0, 1, NOTHING):
        assert (states(monkeypatch, 0.1, solid)[TIPS] == VISIBLE).all()


def test_properties_what_is_before_a_fingertip_hides_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for solid in (0, 1):
        assert (states(monkeypatch, -0.1, solid)[TIPS] == OCCLUDED).all()
