"""Hand poses: mixture and uniform, always within the limits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from synthgen.errors import SamplingError
from synthgen.models import ManoModel, load
from synthgen.sampling.hand_pose import HandPosePrior, fit_prior, prior_of, sample_hand_pose
from synthgen.sampling.limits import limits_of, violation
from synthgen.sampling.streams import stream


@pytest.fixture(scope="module")
def hand() -> ManoModel:
    return load("cc0-hand", hand="right")


@pytest.fixture(scope="module")
def prior(hand: ManoModel) -> HandPosePrior:
    return prior_of(hand, 10, 15)


def test_shape_of_the_mixture(prior: HandPosePrior) -> None:
    assert prior.weights.shape == (10,)
    assert prior.means.shape == (10, 15)
    assert prior.weights.sum() == pytest.approx(1.0)


def test_reference_moments_of_the_table(hand: ManoModel, prior: HandPosePrior) -> None:
    """The mixture's mean and spread are those of the pose table that it was fitted to."""
    rng = stream(0, "sample", 0, 0, "moments")
    draws = np.array([prior.sample(rng=rng)[1:].ravel() for _ in range(4000)])
    table = hand.hands_coeffs[:, :15] @ hand.hands_components[:15] + hand.hands_mean
    np.testing.assert_allclose(draws.mean(0), table.mean(0), atol=0.05)
    np.testing.assert_allclose(draws.std(0), table.std(0), atol=0.06)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_properties_within_limits(hand: ManoModel, prior: HandPosePrior, share: float) -> None:
    rng = stream(0, "sample", 1, 0, "limits")
    limits = limits_of(hand)
    drawn = [sample_hand_pose(limits, prior, gmm_share=share, rng=rng) for _ in range(60)]
    assert max(violation(limits, pose).max() for pose, _ in drawn) < 1e-6
    assert all(np.all(pose[0] == 0) for pose, _ in drawn)
    assert {"gmm", "uniform"} >= {source for _, source in drawn}
    if share == 1.0:
        assert all(source == "gmm" for _, source in drawn)


def test_edge_no_pose_table(hand: ManoModel) -> None:
    bare = dataclasses.replace(hand, hands_coeffs=None)
    with pytest.raises(SamplingError, match="gmm_share=0"):
        fit_prior(bare)
