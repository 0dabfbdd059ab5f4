"""What is said about every fail of a hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from synthgen.registration.advice import advice
from synthgen.registration.verdict import REASONS, Judgement
from tests.registration.test_verdict import GOOD

NEVER_OF_HANDS = ("no_points", "scale", "two_hands", "two_bodies", "flipped_normals",
                  "part_missed", "hole", "truth_mismatch", "false_pass")  # fmt: skip


@pytest.mark.parametrize("reason", [r for r in REASONS if r not in NEVER_OF_HANDS])
def test_properties_every_fail_is_explained(reason: str) -> None:
    judgement = Judgement("fail", reason, ("ring", "pinky") if "finger" in reason else ())
    said = advice(judgement, GOOD, "right")
    assert said
    assert advice(judgement, None, "right") is not None
    assert ("ring and pinky" in said) == ("finger" in reason)


def test_properties_noise_and_misfit_are_told_apart() -> None:
    judgement = Judgement("fail", "noise_above_spec")
    noisy = replace(GOOD, noise_m=3e-3, local_noise_m=3e-3)
    assert "scatter by 3.0 mm" in str(advice(judgement, noisy, "right"))
    assert "no hand" in str(advice(judgement, replace(noisy, local_noise_m=2e-4), "right"))


@pytest.mark.parametrize(("side", "other"), [("right", "left"), ("left", "right")])
def test_properties_the_other_hand_is_offered(side: str, other: str) -> None:
    assert f"hand {other}" in str(advice(Judgement("fail", "other_hand"), None, side))


def test_edge_a_pass_needs_no_advice() -> None:
    assert advice(Judgement("pass"), GOOD, "right") is None
    assert advice(Judgement("unobserved", "hole", ("ring",)), GOOD, "right") is None
