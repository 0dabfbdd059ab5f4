"""Arms begun afresh: on their own points, whatever they were taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from synthgen.models.joints import SIDES
from synthgen.registration.body_arms import arm_begun_afresh
from synthgen.registration.body_fit import BodyCandidate, body_scan, judged
from synthgen.registration.body_hands import begun_afresh, hand_part
from synthgen.registration.body_prior import body_priors
from synthgen.registration.body_schedule import hand_vertices
from synthgen.registration.body_search import BodySearch
from synthgen.registration.verdict import Judgement
from tests.registration.bodies import errors_mm, scan, scanned, surface, truth


def raised(side: str) -> np.ndarray:
    """The truth but for one arm, which is where none of its points are."""
    x, s = truth().copy(), surface()
    shoulder = s.joint(f"{side}_shoulder")
    up = [0, 0, 2.0 if side == "left" else -2.0]
    x[shoulder] = (Rotation.from_rotvec(up) * Rotation.from_rotvec(x[shoulder])).as_rotvec()
    x[s.hands[side]] = body_priors(s).hands[side].mean
    return x


@pytest.mark.parametrize("side", SIDES)
def test_properties_a_lost_arm_is_found_again(side: str) -> None:
    x, s = raised(side), surface()
    assert errors_mm(s.at(x).vertices)[side] > 300
    found = arm_begun_afresh(body_priors(s), scan(), x, side)
    assert errors_mm(s.at(found).vertices)[side] < 50
    hand = begun_afresh(body_priors(s), scan(), found, side)
    assert errors_mm(s.at(hand).vertices)[side] < 8
    own = [np.r_[s.joint(f"{side}_{name}")] for name in ("shoulder", "elbow", "wrist")]
    same = np.setdiff1d(np.arange(s.n), np.concatenate([*own, np.r_[s.hands[side]]]))
    np.testing.assert_array_equal(found[same], x[same])


@pytest.mark.parametrize("lost", [0.0, 1.0])
def test_properties_an_arm_in_its_place_stays(lost: float) -> None:
    """Without a search, also where its hand was not scanned."""
    s = surface()
    x, own = truth(), body_scan(*scanned(0, lost=lost))
    for side in SIDES:
        np.testing.assert_array_equal(arm_begun_afresh(body_priors(s), own, x, side), x)


def test_properties_with_its_arm_the_body_passes() -> None:
    search = BodySearch(body_priors(surface()), scan())
    found = judged(search, search.arms_again(raised("left"), ["left"]))
    assert found.judgement.verdict == "pass"
    off = errors_mm(found.placed.vertices)
    assert off["body"] < 0.8
    assert off["left"] < 2.5


@pytest.mark.parametrize(
    ("parts", "arms", "hands"),
    [(("left_arm",), ["left"], []), (("left_hand", "right_hand"), [], ["left", "right"]),
     (("right_arm", "right_hand", "torso"), ["right"], []), (("head",), [], []), ((), [], [])],
)  # fmt: skip
def test_reference_what_was_missed(
    parts: tuple[str, ...], arms: list[str], hands: list[str]
) -> None:
    judgement = Judgement("fail", "part_missed", parts) if parts else Judgement("pass")
    one = BodyCandidate(None, None, judgement)  # type: ignore[arg-type]
    assert one.missed_arms == arms
    assert one.missed_hands == hands


def test_shape_the_whole_arm_is_a_part() -> None:
    s = surface()
    hand, arm = hand_part(s, "left"), hand_part(s, "left", True)
    assert hand.shoulder is None
    assert (len(hand.arm), len(arm.arm)) == (6, 9)
    assert arm.surface.n_vertices > hand.surface.n_vertices
    names = np.array([f"left_{name}" for name in ("shoulder", "elbow", "wrist")])
    places = np.concatenate([np.r_[s.joint(name)] for name in names])
    np.testing.assert_array_equal(arm.columns[arm.arm], places)


def test_edge_an_arm_without_points_stays() -> None:
    s, points = surface(), scan().points
    placed = s.at(truth())
    arm = np.isin(s.model.weights.argmax(axis=1), [
        s.model.joint_names.index(f"left_{name}") for name in ("shoulder", "elbow")])  # fmt: skip
    arm[hand_vertices(s, "left")] = True
    far = cKDTree(placed.vertices[arm]).query(points)[0] > 0.05
    body = cKDTree(placed.vertices[~arm]).query(points)[0] < 0.02
    bare = replace(scan(), points=points[far & body], normals=scan().normals[far & body])
    np.testing.assert_array_equal(arm_begun_afresh(body_priors(s), bare, truth(), "left"), truth())
