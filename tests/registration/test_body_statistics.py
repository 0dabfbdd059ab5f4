"""Verdicts of bodies from their statistics, part by part."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from synthgen.registration.body_statistics import (
    PARTS,
    BodyStatistics,
    judge_body,
    part_of_vertex,
)
from synthgen.registration.verdict import REASONS
from tests.registration.bodies import model

N = len(PARTS)


def good() -> BodyStatistics:
    return BodyStatistics(
        explained=0.998, far=0.01, limit_m=4e-3, noise_m=8e-4, local_noise_m=8e-4,
        points=np.full(N, 500),
        unexplained=np.full(N, 0.003), p95_m=np.full(N, 2e-3), coverage=np.full(N, 0.95),
        sd95_m=np.full(N, 8e-4), sd_m=np.full(10, 5e-4),
    )  # fmt: skip


def but(part: str, value: float, others: float) -> np.ndarray:
    return np.where(np.array(PARTS) == part, value, others)


@pytest.mark.parametrize(
    ("change", "verdict", "text"),
    [
        ({}, "pass", ""),
        ({"unexplained": but("left_hand", 0.05, 0.0)}, "fail", "part_missed(left_hand)"),
        ({"unexplained": but("left_leg", 0.04, 0.0)}, "pass", ""),
        ({"unexplained": but("left_leg", 0.08, 0.0)}, "fail", "part_missed(left_leg)"),
        ({"unexplained": but("left_leg", 0.08, 0.0), "noise_m": 1.5e-3}, "pass", ""),
        (
            {"unexplained": but("left_leg", 0.2, 0.0), "noise_m": 1.5e-3},
            "fail",
            "part_missed(left_leg)",
        ),
        ({"sd95_m": but("right_hand", 0.02, 1e-3)}, "unobserved", "hole(right_hand)"),
        ({"coverage": but("right_hand", 0.4, 0.9)}, "unobserved", "hole(right_hand)"),
        ({"coverage": but("head", 0.4, 0.9)}, "pass", ""),
        ({"explained": 0.8}, "fail", "cold_start_failed"),
        ({"far": 0.5}, "fail", "background"),
        ({"noise_m": 6e-3}, "fail", "noise_above_spec"),
        ({"unexplained": np.full(N, np.nan)}, "pass", ""),
    ],
)
def test_properties_gates(change: dict[str, Any], verdict: str, text: str) -> None:
    found = judge_body(replace(good(), **change), np.zeros(16))
    assert (found.verdict, found.text) == (verdict, text)
    assert found.reason in ("", *REASONS)


def test_properties_shape_limit() -> None:
    assert judge_body(good(), np.full(16, 4.5)).reason == "shape_limit"


@pytest.mark.parametrize("name", ["cc0-body", "cc0-supr"])
def test_properties_every_vertex_has_its_part(name: str) -> None:
    part, rest = part_of_vertex(model(name)), model(name).v_template
    middle = {p: rest[part == k].mean(axis=0) for k, p in enumerate(PARTS)}
    assert middle["head"][1] > middle["torso"][1] > middle["left_leg"][1] > middle["left_foot"][1]
    assert middle["left_hand"][0] > middle["left_arm"][0] > 0 > middle["right_hand"][0]


def test_properties_json_is_json() -> None:
    import json

    broken = replace(good(), unexplained=np.full(N, np.nan))
    assert '"unexplained": null' in json.dumps(broken.to_json())
