"""The picture of a fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from synthgen.models.joints import SIDES
from synthgen.registration.body_schedule import hand_vertices
from synthgen.registration.overlay import BODY, SIZE, draw_overlay, error_colours, save_overlay
from tests.registration import bodies
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


def test_properties_bodies_stand_and_their_hands_are_drawn_closely() -> None:
    """Five rows; the head is up, so that the upper third of the first picture is narrow."""
    s, x = bodies.surface(), bodies.truth()
    placed, hands = s.at(x), [hand_vertices(s, side) for side in SIDES]
    picture = draw_overlay(bodies.scanned()[0], placed.vertices, s.faces, "body", hands)
    size = BODY.size
    assert picture.shape == (5 * size + 26, 3 * size, 3)
    front = picture[26 : 26 + size, 2 * size :].min(axis=2) < 250
    rows = np.flatnonzero(front.any(axis=1))
    top, bottom = rows[0], rows[-1]
    assert bottom - top > 0.5 * size
    width = front.sum(axis=1)
    assert width[top : top + 40].max() < width[top:bottom].max() / 2
    hand = picture[26 + 3 * size : 26 + 4 * size, 2 * size :].reshape(-1, 3).astype(int)
    skin = hand[hand.min(axis=1) < 250]
    assert len(skin) > 0.05 * size**2
    assert np.mean((skin[:, 0] > 100) & (skin[:, 1] < 60)) < 0.05  # hardly any red
