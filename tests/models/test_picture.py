"""Pictures of components: something is drawn, where it should be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import body_files
import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.models import load, load_hand
from synthgen.models.picture import TILE, draw, model_picture
from synthgen.models.views import view_of
from synthgen.sampling.streams import stream


def test_reference_a_square_is_drawn_where_it_is() -> None:
    hand = load_hand("cc0-hand")
    axes = view_of(hand, "")
    assert np.abs(axes.axes @ axes.axes.T - np.eye(3)).max() < 1e-12
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * 0.5
    front = replace(axes, axes=np.eye(3))
    image = draw(corners, np.array([[0, 1, 2], [0, 2, 3]]), front, np.zeros(3), 1.0)
    drawn = (image < 0.999).any(axis=2)
    rows, columns = np.nonzero(drawn)
    middle = (TILE - 1) / 2
    assert rows.max() < middle + 1  # up is up
    assert columns.min() > middle - 1
    reach = 0.5 / 1.12 * TILE / 2
    assert np.ptp(rows) == pytest.approx(reach, abs=2)
    assert np.ptp(columns) == pytest.approx(reach, abs=2)


@pytest.mark.parametrize("hand", ["left", "right"])
def test_properties_fingers_point_up(hand: str) -> None:
    model = load_hand("cc0-hand", hand=hand)
    axes = view_of(model, "").axes
    joints = model.J_regressor @ model.v_template
    middle, thumb = (axes @ (joints[k] - joints[0]) for k in (4, 15))
    assert middle[1] > 0.9 * np.linalg.norm(middle)
    assert (thumb[0] < 0) == (hand == "right")


@pytest.mark.parametrize("family", ["smplh", "supr", "star"])
def test_smoke_bodies(family: str, tmp_path: Path) -> None:
    content = body_files.body(family, pairs=200) | (body_files.hands() if family == "smplh" else {})
    np.savez(tmp_path / "body.npz", **content)
    model = load(tmp_path / "body.npz")
    if family == "supr":
        rng = stream(0, "sample", 0, 0, "expression")
        model = replace(model, exprdirs=rng.normal(0, 0.01, (len(model.v_template), 3, 3)))
    path = model_picture(model, tmp_path / "body.png", components=1)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_edge_where_it_cannot_be_written(tmp_path: Path) -> None:
    hand = load_hand("cc0-hand")
    with pytest.raises(ModelError, match=r"\.png"):
        model_picture(hand, tmp_path / "hand.bmp")
    with pytest.raises(ModelError, match="cannot be written"):
        model_picture(hand, tmp_path / "none" / "hand.png", components=1)
