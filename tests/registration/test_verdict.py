"""Verdicts from statistics made by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from synthgen.registration.statistics import PARTS, Statistics, statistics
from synthgen.registration.verdict import REASONS, explains_more, judge, sd_limit_m
from tests.registration.hands import scan, surface, truth

GOOD = Statistics(
    explained=0.995,
    far=0.01,
    limit_m=1e-3,
    noise_m=2e-4,
    local_noise_m=2e-4,
    rms_m=2e-4,
    counts=np.full(6, 2000.0),
    unexplained=np.full(6, 0.01),
    p95_m=np.full(6, 4e-4),
    ratios=np.ones(6),
    biased=np.zeros(6),
    coverage=np.full(6, 0.7),
    tip_coverage=np.full(6, 0.6),
    sd_m=np.full(100, 1e-4),
    sd95_m=np.full(6, 1e-4),
)
BETA = np.zeros(10)


def one_bad(*parts: str) -> np.ndarray:
    return np.array([0.2 if part in parts else 0.01 for part in PARTS])


@pytest.mark.parametrize(
    ("change", "verdict", "reason"),
    [
        ({}, "pass", ""),
        ({"explained": 0.9}, "fail", "cold_start_failed"),
        ({"noise_m": 3e-3}, "fail", "noise_above_spec"),
        ({"far": 0.4}, "fail", "background"),
        ({"unexplained": one_bad("ring")}, "fail", "finger_missed(ring)"),
        ({"unexplained": 0.3 * one_bad("ring")}, "fail", "finger_missed(ring)"),
        ({"unexplained": 0.3 * one_bad("ring"), "counts": np.full(6, 120.0)}, "pass", ""),
        ({"unexplained": one_bad("ring"), "counts": np.full(6, 60.0)}, "fail",
         "finger_missed(ring)"),
        ({"unexplained": one_bad("ring", "pinky")}, "fail", "finger_swap"),
        ({"unexplained": one_bad("ring", "pinky", "palm")}, "fail", "cold_start_failed"),
        ({"ratios": 1 + one_bad("ring")}, "fail", "finger_missed(ring)"),
        ({"ratios": 1 + one_bad("ring"), "p95_m": 4e-4 + 1e-3 * one_bad("palm")}, "fail",
         "finger_missed(ring)"),
        ({"ratios": 1 + one_bad("ring"), "noise_m": 4e-4}, "pass", ""),
        ({"unexplained": one_bad("ring"), "explained": 0.9}, "fail", "finger_missed(ring)"),
        ({"unexplained": one_bad("palm"), "explained": 0.9}, "fail", "cold_start_failed"),
        ({"pending": 0.2}, "fail", "not_converged"),
        ({"biased": one_bad("middle")}, "fail", "finger_missed(middle)"),
        ({"biased": np.full(6, 0.4)}, "pass", ""),
        ({"biased": one_bad("middle"), "noise_m": 4e-4}, "pass", ""),
        ({"biased": np.full(6, np.nan)}, "pass", ""),
        ({"sd_m": np.full(100, 2e-3), "sd95_m": np.array([0, 0, 0, 2e-3, 0, 0])}, "unobserved",
         "hole(pinky)"),
        ({"sd95_m": np.array([0, 0, 0, 0, 0, 11e-3]), "inflation": 1e3}, "unobserved",
         "hole(thumb)"),
        ({"sd95_m": np.array([0, 0, 0, 0, 0, 6e-3]), "inflation": 1e3}, "pass", ""),
        ({"sd95_m": np.array([0, 0, 0, 0, 0, 6e-3]), "inflation": 1e3,
          "tip_coverage": 0.6 - 3 * one_bad("thumb")}, "unobserved", "hole(thumb)"),
        ({"tip_coverage": 0.6 - 3 * one_bad("thumb")}, "pass", ""),
    ],
)  # fmt: skip
def test_reference_verdicts(change: dict[str, Any], verdict: str, reason: str) -> None:
    found = judge(replace(GOOD, **change), BETA)
    assert found.verdict == verdict
    assert found.text.startswith(reason)
    assert found.reason in ("", *REASONS)


@pytest.mark.parametrize(("number", "degrees"), [(5, -15), (7, 10), (9, 6)])
@pytest.mark.parametrize("finger", PARTS[1:])
def test_properties_a_misplaced_finger_is_named(number: int, degrees: float, finger: str) -> None:
    """Bent in its middle joint, of a pose that is right else; one lies at its neighbour then."""
    x = truth(number).copy()
    x[surface().fingers.start + 9 * (PARTS.index(finger) - 1) + 5] += np.deg2rad(degrees)
    found = statistics(surface().at(x), scan(number), 1e-10 * np.eye(len(x)))
    judgement = judge(found, x[surface().shape])
    assert (judgement.reason, judgement.parts) == ("finger_missed", (finger,))


def test_reference_extreme_shape() -> None:
    assert judge(GOOD, np.array([5.0, 0])).reason == "shape_limit"


def test_properties_limit_grows_with_noise() -> None:
    assert sd_limit_m(2e-4) == sd_limit_m(1e-4)
    assert sd_limit_m(2e-3) > sd_limit_m(1e-3)
    assert sd_limit_m(2e-4, inflation=9.0) == 3 * sd_limit_m(2e-4)


def test_smoke_json_is_json() -> None:
    import json

    row = GOOD.to_json()
    assert json.loads(json.dumps(row))["parts"]["palm"]["coverage"] == 0.7
    empty = replace(GOOD, unexplained=np.full(6, np.nan), p95_m=np.full(6, np.nan))
    assert empty.to_json()["parts"]["ring"]["p95_mm"] is None
    assert empty.worst_unexplained == 0


def test_properties_a_fit_explains_more_than_another() -> None:
    worse = replace(GOOD, explained=0.98, noise_m=3e-4)
    assert explains_more(GOOD, worse)
    assert not explains_more(worse, GOOD)
    assert explains_more(worse, None)
    assert not explains_more(None, GOOD)
    assert not explains_more(replace(GOOD, explained=0.999), GOOD)
    assert not explains_more(replace(GOOD, sd95_m=np.full(6, 0.05)), worse)
