"""Edges of labels are found in their own picture, and not in another."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from synthgen.sampling import stream
from synthgen.verify.picture import found_share, outline

SIZE = 160


def disc(column: float, radius: float = 30.0) -> NDArray[np.int64]:
    rows, columns = np.mgrid[:SIZE, :SIZE]
    return (np.hypot(rows - 80, columns - column) < radius).astype(np.int64)


def picture(mask: NDArray[np.int64], contrast: float, seed: int) -> NDArray[np.uint8]:
    rng = stream(seed, "corpus", 0, 0, "noise")
    grey = 120 + contrast * mask + rng.normal(0, 15, mask.shape)
    return np.repeat(np.clip(grey, 0, 255)[..., None], 3, axis=2).astype(np.uint8)


@pytest.mark.parametrize("contrast", [25.0, 60.0, -60.0])
def test_properties_own_outline_is_found_another_is_not(contrast: float) -> None:
    depth = np.ones((SIZE, SIZE))
    shown = picture(disc(80), contrast, seed=1)
    own = found_share(shown, outline(disc(80), depth))
    other = found_share(shown, outline(disc(92), depth))
    assert own is not None and other is not None
    assert own > 0.95
    assert other < 0.5


def test_reference_nothing_shown_is_chance() -> None:
    shown = picture(disc(80), 0.0, seed=2)
    found = found_share(shown, outline(disc(80), np.ones((SIZE, SIZE))))
    assert found is not None and found < 0.45


def test_reference_outline_has_jumps_within_a_hand() -> None:
    depth = np.where(np.arange(SIZE) < 80, 0.5, 0.6)[None].repeat(SIZE, axis=0)
    edges = outline(disc(80), depth)
    assert edges[80, 80]
    assert not edges[5, 80]  # the background's jumps are no hand's
    assert not outline(disc(80), np.ones((SIZE, SIZE)))[80, 80]


def test_edge_too_little_to_tell() -> None:
    small = disc(80, radius=5)
    assert found_share(picture(small, 0.0, seed=3), outline(small, np.ones((SIZE, SIZE)))) is None
