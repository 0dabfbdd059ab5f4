"""Priors of bodies: the A-pose, hands in six components, and what lies beyond them."""

from __future__ import annotations

import numpy as np
import pytest

from synthgen.registration.body_prior import body_priors, joint_sd, known_hands
from synthgen.registration.terms import MixturePrior
from tests.registration.bodies import NAMES, model, rng, surface


def cost(term: MixturePrior, x: np.ndarray, name: str = "cc0-body") -> float:
    placed = surface(name).at(x)
    return term.cost(placed, term.match(placed))


@pytest.mark.parametrize("name", NAMES)
def test_smoke_start_is_an_a_pose(name: str) -> None:
    """Arms hang half way down: hands are below the shoulders and farther out."""
    priors, s = body_priors(surface(name)), surface(name)
    joints, names = s.at(priors.start).joints, model(name).joint_names
    for side, sign in (("left", 1), ("right", -1)):
        arm = joints[names.index(f"{side}_wrist")] - joints[names.index(f"{side}_shoulder")]
        assert arm[1] < -0.25
        assert sign * arm[0] > 0.25


@pytest.mark.parametrize("name", NAMES)
def test_properties_which_joints_are_held(name: str) -> None:
    """Everything but root, fingers and eyes."""
    priors, s = body_priors(surface(name)), surface(name)
    held = {(k - s.pose.start) // 3 for k in priors.joints}
    free = {n for k, n in enumerate(model(name).joint_names) if k not in held}
    fingers = {
        n for n in free if any(f in n for f in ("index", "middle", "ring", "pinky", "thumb"))
    }
    assert free - fingers <= {"pelvis", "left_eye", "right_eye"}
    assert len(fingers) == 30
    assert joint_sd("left_pinkytoe2") == joint_sd("right_bigtoe1") < joint_sd("left_ankle")


def test_reference_six_components_carry_the_mixture() -> None:
    """Along the six the mixture changes and the complement does not; beyond, the other way."""
    priors = body_priors(surface())
    hand, space = priors.hands["right"], known_hands(model(), "right")
    where = surface().hands["right"]
    base = priors.start.copy()
    base[where] = hand.mean
    for k, own, other in ((3, hand.mixture, hand.complement), (9, hand.complement, hand.mixture)):
        moved = base.copy()
        moved[where] += 0.3 * space.components[k]
        assert abs(cost(own, moved) - cost(own, base)) > 0.05
        assert cost(other, moved) == pytest.approx(cost(other, base), abs=1e-6)


def test_properties_known_poses_are_likelier_than_twisted_ones() -> None:
    """Fingers turned about their bones are what the complement prevents."""
    priors, s = body_priors(surface()), surface()
    hand, space = priors.hands["left"], known_hands(model(), "left")
    assert space.coeffs is not None
    known, twisted = priors.start.copy(), priors.start.copy()
    known[s.hands["left"]] = space.mean + space.coeffs[7] @ space.components
    twisted[s.hands["left"]] = known[s.hands["left"]]
    twisted[s.hands["left"]][0::3] += rng("twist").choice([-0.5, 0.5], 15)
    assert cost(hand.complement, twisted) > cost(hand.complement, known) + 50


def test_properties_typical_poses_are_different_hands() -> None:
    typical = body_priors(surface()).hands["left"].typical
    apart = np.linalg.norm(typical[:, None] - typical, axis=2) + 10 * np.eye(len(typical))
    assert len(typical) == 10
    assert apart.min() > 0.1
