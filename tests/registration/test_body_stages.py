"""Where a body's fit begins, what its stages free, and hands begun afresh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from synthgen.models.joints import SIDES
from synthgen.registration import body_schedule as schedule
from synthgen.registration.body_hands import begun_afresh
from synthgen.registration.body_prior import body_priors
from synthgen.registration.body_start import spread_yaws, starts, yaws
from synthgen.registration.scan import Scan
from synthgen.registration.schedule import last_stage
from synthgen.registration.terms import ScanToMesh
from tests.registration.bodies import NAMES, errors_mm, model, scan, surface, truth


def turned(angle: float) -> Scan:
    turn = Rotation.from_rotvec([0, angle, 0]).as_matrix()
    return replace(scan(), points=scan().points @ turn.T, normals=scan().normals @ turn.T)


def heading(x: np.ndarray) -> float:
    side = Rotation.from_rotvec(x[surface().root]).as_matrix()[:, 0]
    return float(np.arctan2(-side[2], side[0]))


@pytest.mark.parametrize("angle", [0.0, 1.1, 2.5, -2.0])
def test_properties_one_of_two_turns_is_right(angle: float) -> None:
    wanted = heading(truth()) + angle
    off = [abs((turn - wanted + np.pi) % (2 * np.pi) - np.pi) for turn in yaws(turned(angle))]
    assert min(off) < np.deg2rad(15)
    assert max(off) > np.deg2rad(165)


def test_properties_starts_are_as_tall_as_the_scan() -> None:
    found = starts(body_priors(surface()), scan(), spread_yaws())
    assert len(found) == 8
    points = surface().at(truth()).vertices
    for x in found[:2]:
        vertices = surface().at(x).vertices
        assert np.ptp(vertices[:, 1]) == pytest.approx(np.ptp(points[:, 1]), abs=0.06)
        np.testing.assert_allclose(np.median(vertices, axis=0), np.median(points, axis=0), atol=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_reference_what_stages_free(name: str) -> None:
    priors, s = body_priors(surface(name)), surface(name)
    inner = 3 * sum("toe" in n or n == "jaw" for n in model(name).joint_names)
    ne, nb = model(name).n_expression, model(name).n_shape
    outer = len(priors.joints) - inner
    wanted = {
        schedule.RIGID: 7,
        schedule.LOOSE: 6 + 5 + outer,
        schedule.CLOSE: 6 + 16 + outer + 12,
        schedule.FINE: 6 + nb + outer + 12 + ne,
        schedule.SHAPE: 6 + nb + len(priors.joints) + 90 + ne,
        schedule.LAST: 6 + len(priors.joints) + 90 + ne,
    }
    for stage, count in wanted.items():
        basis = schedule.basis_of(priors, stage)
        assert basis.shape == (s.n, count)
        assert np.linalg.matrix_rank(basis) == count


def test_properties_crops_are_around_the_hands() -> None:
    placed = surface().at(truth())
    for side, crop in zip(SIDES, schedule.hand_crops(placed, scan()), strict=True):
        hand = placed.vertices[schedule.hand_vertices(surface(), side)]
        distance = cKDTree(hand).query(scan().points[crop])[0]
        assert distance.max() <= schedule.MARGIN_M
        assert len(crop) > 500


def test_properties_data_weighs_as_much_with_few_points() -> None:
    """A scan of fewer points than a stage takes counts for less, point for point."""
    stage = schedule.LOOSE
    few = replace(scan(), points=scan().points[:350], normals=scan().normals[:350])
    whole, half = (schedule.body_terms(surface(), s, stage, ())[0] for s in (scan(), few))
    assert half.weight == pytest.approx(whole.weight / 2)  # type: ignore[attr-defined]


def test_properties_hands_weigh_apart_where_the_others_are_known() -> None:
    """At 0.2 mm a point of the body says 36 times as much as a hand's, which is scanned worse."""
    placed = surface().at(truth())
    crops, others = schedule.hand_crops(placed, scan()), schedule.without_hands(placed, scan())
    assert others is not None
    for noise_m, wanted in ((2e-4, 36.0), (2e-3, 1.0)):
        stage = last_stage(schedule.LAST, noise_m)
        body, hands = schedule.body_terms(surface(), scan(), stage, (), crops, others)
        assert isinstance(body, ScanToMesh)
        assert isinstance(hands, ScanToMesh)
        each = [term.weight / len(term.points) for term in (body, hands)]
        assert each[0] == pytest.approx(1 / noise_m**2)
        assert each[0] / each[1] == pytest.approx(wanted)
    hand = np.concatenate([schedule.hand_vertices(surface(), side) for side in SIDES])
    away = cKDTree(placed.vertices[hand]).query(body.points)[0]
    assert np.median(away) > 0.2
    assert (away < schedule.HANDS_M).mean() < 0.005  # every third vertex of a hand is looked at


@pytest.mark.parametrize("side", SIDES)
def test_properties_a_hand_turned_over_is_found_again(side: str) -> None:
    """The forearm twisted by 150 degrees and another pose of the fingers: a local minimum."""
    x, s = truth().copy(), surface()
    elbow = Rotation.from_rotvec(x[s.joint(f"{side}_elbow")])
    x[s.joint(f"{side}_elbow")] = (elbow * Rotation.from_rotvec([2.6, 0, 0])).as_rotvec()
    x[s.hands[side]] = body_priors(s).hands[side].mean
    assert errors_mm(s.at(x).vertices)[side] > 40
    found = begun_afresh(body_priors(s), scan(), x, side)
    assert errors_mm(s.at(found).vertices)[side] < 8
    same = np.setdiff1d(np.arange(s.n), np.r_[s.hands[side], s.joint(f"{side}_elbow"),
                                              s.joint(f"{side}_wrist")])  # fmt: skip
    np.testing.assert_array_equal(found[same], x[same])


def test_edge_a_hand_without_points_stays() -> None:
    points = scan().points
    hand = surface().at(truth()).vertices[schedule.hand_vertices(surface(), "left")]
    far = cKDTree(hand).query(points)[0] > 0.25
    bare = replace(scan(), points=points[far], normals=scan().normals[far])
    x = truth()
    np.testing.assert_array_equal(begun_afresh(body_priors(surface()), bare, x, "left"), x)
