"""Joint limits: angles and poses convert both ways, samples stay inside."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.models import load
from synthgen.sampling.limits import (
    JointLimits,
    clamp,
    from_angles,
    limits_of,
    sample_uniform,
    to_angles,
    violation,
)
from synthgen.sampling.streams import stream


@pytest.fixture(scope="module")
def limits() -> JointLimits:
    return limits_of(load("cc0-hand"))


def rng(name: str) -> np.random.Generator:
    return stream(0, "sample", 0, 0, name)


def test_properties_axes_are_orthonormal(limits: JointLimits) -> None:
    gram = limits.axes[1:] @ limits.axes[1:].transpose(0, 2, 1)
    np.testing.assert_allclose(gram, np.tile(np.eye(3), (15, 1, 1)), atol=1e-9)


def test_properties_round_trip(limits: JointLimits) -> None:
    pose = sample_uniform(limits, rng=rng("trip"), n=50)
    np.testing.assert_allclose(from_angles(limits, to_angles(limits, pose)), pose, atol=1e-9)


def test_properties_uniform_samples_respect_limits(limits: JointLimits) -> None:
    pose = sample_uniform(limits, rng=rng("inside"), n=300)
    assert violation(limits, pose).max() < 1e-9
    pip = to_angles(limits, pose)[:, 2, 0]
    assert np.ptp(np.rad2deg(pip)) > 85  # and fill them


def test_properties_clamp_moves_only_what_is_outside(limits: JointLimits) -> None:
    wild = rng("wild").normal(0, 1.2, (40, 16, 3))
    tame = clamp(limits, wild)
    assert violation(limits, tame).max() < 1e-6
    np.testing.assert_array_equal(tame[:, 0], wild[:, 0])
    inside = sample_uniform(limits, rng=rng("tame"), n=5)
    np.testing.assert_allclose(clamp(limits, inside), inside, atol=1e-9)


def test_reference_flexion_curls_to_the_palm_on_both_sides() -> None:
    for side in ("right", "left"):
        model = load("cc0-hand", hand=side)
        angles = np.zeros((1, 16, 3))
        angles[0, [1, 4, 7, 10], 0] = np.deg2rad(80)
        pose = from_angles(limits_of(model), angles)
        posed = model.evaluate(np.zeros((1, 10)), pose)
        tips = posed.vertices[0, model.fingertip_ids[1:]]
        assert np.all(tips[:, 1] < -0.03)  # the palm looks down, -y


def test_reference_abduction_spreads() -> None:
    model = load("cc0-hand")
    angles = np.zeros((1, 16, 3))
    angles[0, [1, 7, 10], 1] = np.deg2rad(15)
    flat = model.evaluate(np.zeros((1, 10)), np.zeros((1, 16, 3))).vertices[0]
    wide = model.evaluate(np.zeros((1, 10)), from_angles(limits_of(model), angles)).vertices[0]
    index, pinky = model.fingertip_ids[1], model.fingertip_ids[4]
    gap = [np.linalg.norm(v[index] - v[pinky]) for v in (flat, wide)]
    assert gap[1] > gap[0] + 0.02
