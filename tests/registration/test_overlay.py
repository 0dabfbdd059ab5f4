"""The picture of a fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from synthgen.registration.overlay import SIZE, draw_overlay, error_colours, save_overlay
from tests.registration.hands import scanned, surface, truth


def test_smoke_picture(tmp_path: Path) -> None:
    vertices = surface().at(truth()).vertices
    picture = draw_overlay(scanned()[0], vertices, surface().faces, "a fit")
    assert picture.shape == (3 * SIZE + 26, 3 * SIZE, 3)
    errors = picture[26:, 2 * SIZE :].astype(int)
    green = (errors[..., 1] > errors[..., 0] + 20) & (errors[..., 1] > errors[..., 2] + 20)
    assert green.mean() > 0.02  # what was seen fits
    save_overlay(tmp_path / "fit.png", picture)
    assert (tmp_path / "fit.png").stat().st_size > 10_000


def test_reference_colours() -> None:
    colours = error_colours(np.array([0.0, 1e-3, np.inf]))
    assert colours[0, 1] > colours[0, 0]
    assert colours[1, 0] > colours[1, 1]
    np.testing.assert_allclose(colours[2], 0.6)


def test_edge_no_points() -> None:
    vertices = surface().at(truth()).vertices
    assert draw_overlay(np.zeros((0, 3)), vertices, surface().faces).shape[2] == 3
