"""Masks for hands that bring none: read from the nearest place of the shipped hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from synthgen.models import ManoModel, load
from synthgen.scene.transfer import masks_of


@pytest.fixture(scope="module")
def hand() -> ManoModel:
    return load("cc0-hand")


def written(hand: ManoModel, path: Path, vertices: np.ndarray) -> ManoModel:
    table = np.stack([np.where(hand.parents < 0, 4294967295, hand.parents), np.arange(16)])
    np.savez(
        path, v_template=vertices, shapedirs=hand.shapedirs, posedirs=hand.posedirs,
        weights=hand.weights, J_regressor=hand.J_regressor, kintree_table=table, f=hand.faces,
        hands_mean=hand.hands_mean, hands_components=hand.hands_components,
    )  # fmt: skip
    return load(path)


def test_smoke_the_shipped_hand_keeps_its_own(hand: ManoModel) -> None:
    palm, nail = masks_of(hand)
    np.testing.assert_array_equal(palm, hand.surface.mask_palm)
    np.testing.assert_array_equal(nail, hand.surface.mask_nail)


def test_reference_the_same_hand_as_a_bare_file(hand: ManoModel, tmp_path: Path) -> None:
    palm, nail = masks_of(written(hand, tmp_path / "same.npz", hand.v_template))
    n = len(hand.v_template)
    np.testing.assert_allclose(palm[:n], hand.surface.mask_palm[:n], atol=1e-6)
    np.testing.assert_allclose(nail[:n], hand.surface.mask_nail[:n], atol=1e-6)


def test_properties_another_persons_hand(hand: ManoModel, tmp_path: Path) -> None:
    """Longer, thicker, moved: most vertices still read what they read on their own hand."""
    shaped, _ = hand.shaped(np.array([2.0, -1.5, 1.0, 0.5, 0, 0, 0, 0, 0, 0]))
    model = written(hand, tmp_path / "other.npz", 1.12 * shaped + [0.09, 0.01, 0.0])
    palm, nail = masks_of(model)
    n = len(hand.v_template)
    assert np.mean(np.abs(palm[:n] - hand.surface.mask_palm[:n]) < 0.2) > 0.95
    assert np.mean((nail[:n] > 0.5) == (hand.surface.mask_nail[:n] > 0.5)) > 0.98
    assert (nail[:n] > 0.5).sum() > 0.6 * (hand.surface.mask_nail > 0.5).sum()


def test_edge_left_files_read_the_left_hand(hand: ManoModel, tmp_path: Path) -> None:
    left = load("cc0-hand", hand="left")
    palm, _ = masks_of(written(left, tmp_path / "left.npz", left.v_template))
    n = len(left.v_template)
    np.testing.assert_allclose(palm[:n], left.surface.mask_palm[:n], atol=1e-6)
