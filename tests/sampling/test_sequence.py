"""Sequences: smooth, at the asked speeds, functions of their rng."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from synthgen.errors import SamplingError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import load
from synthgen.sampling.body_contact import limbs_inside
from synthgen.sampling.sequence import PoseSequence, SequenceSettings, sample_sequence
from synthgen.sampling.streams import stream


@lru_cache(maxsize=4)
def drawn(seed: int = 0, name: str = "cc0-body", frames: int = 40) -> PoseSequence:
    settings = SequenceSettings(frames, missing={} if name == "cc0-hand" else {"left": (4, 12)})
    return sample_sequence(load(name), settings, rng=stream(seed, "sample", 0, 0, "sequence"))


@pytest.mark.parametrize("name", ["cc0-body", "cc0-hand"])
def test_properties_speeds(name: str) -> None:
    steps = np.rad2deg(np.abs(np.diff(drawn(0, name).pose, axis=0)))
    hand = steps[:, -30:] if name == "cc0-body" else steps[:, 1:]
    assert 0.4 < hand.mean() < 0.9
    assert steps[:, 1:].max() < 10
    if name == "cc0-body":
        assert 0.25 < steps[:, 1:22].mean() < 0.6


@pytest.mark.parametrize("name", ["cc0-body", "cc0-hand"])
def test_properties_smooth(name: str) -> None:
    """No frame jumps: a change of speed is small beside the speed allowed."""
    sequence = drawn(0, name)
    bends = np.rad2deg(np.abs(np.diff(sequence.pose[:, 1:], 2, axis=0)))
    assert bends.max() < 5
    turns = matrix_from_axis_angle(sequence.pose[:, 0])
    between = np.einsum("fba,fbc->fac", turns[:-1], turns[1:])
    assert np.rad2deg(np.arccos((np.trace(between, axis1=1, axis2=2) - 1) / 2)).max() < 10
    assert np.abs(np.diff(sequence.translation, axis=0)).max() < 0.04
    assert np.abs(np.diff(sequence.pose, axis=0)[:, 1:]).max() > 0.005


def test_properties_a_body_stands_on_the_floor_and_clear_of_itself() -> None:
    model, sequence = load("cc0-body"), drawn()
    np.testing.assert_allclose(sequence.vertices(model)[..., 1].min(axis=1), 0, atol=1e-5)
    for k in range(0, 40, 8):
        assert limbs_inside(model, sequence.shape, sequence.pose[k]) < 0.02


def test_properties_missing_frames() -> None:
    assert np.array_equal(np.flatnonzero(drawn().missing["left"]), np.arange(4, 12))
    assert not drawn().missing["right"].any()


def test_properties_a_function_of_the_rng() -> None:
    model, settings = load("cc0-body"), SequenceSettings(12)
    first, again, other = (
        sample_sequence(model, settings, rng=stream(seed, "sample", 0, 0, "again"))
        for seed in (1, 1, 2)
    )
    assert np.array_equal(first.pose, again.pose)
    assert np.array_equal(first.shape, again.shape)
    assert np.array_equal(first.translation, again.translation)
    assert not np.array_equal(first.pose, other.pose)


def test_edge_one_frame_and_a_given_shape() -> None:
    model = load("cc0-supr")
    given = np.linspace(-1, 1, model.n_shape)
    found = sample_sequence(
        model, SequenceSettings(1), shape=given, rng=stream(0, "sample", 0, 0, "x")
    )
    assert len(found) == 1
    assert found.pose.shape == (1, 75, 3)
    assert np.array_equal(found.shape, given)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        (SequenceSettings(0), "frames=0"),
        (SequenceSettings(10, hand_deg=0), "hand_deg=0"),
        (SequenceSettings(10, missing={"left": (4, 12)}), "stop <= 10"),
        (SequenceSettings(10, missing={"foot": (4, 6)}), "'foot'"),
    ],
)
def test_edge_errors(settings: SequenceSettings, match: str) -> None:
    with pytest.raises(SamplingError, match=match):
        sample_sequence(load("cc0-body"), settings, rng=stream(0, "sample", 0, 0, "x"))
