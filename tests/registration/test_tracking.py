"""Tracking: a body with a missing hand, a hand alone, frames that cannot be fitted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from igl import point_mesh_squared_distance

from synthgen.errors import ModelError, ShapeError
from synthgen.models import load, mirror_pose
from synthgen.registration.body_fit import body_surface
from synthgen.registration.body_schedule import hand_vertices
from synthgen.registration.fitted import Fit
from synthgen.registration.inspection import Finding
from synthgen.registration.scan import Scan
from synthgen.registration.simulated import ScanSettings, simulate_scan, with_detail, with_shape
from synthgen.registration.simulated_body import BodyScanSettings, simulate_body_scan
from synthgen.registration.tracked import Frame, is_lost
from synthgen.registration.tracking import Track, _Walk, track
from synthgen.registration.tracking_hand import HandFollower
from synthgen.registration.tracking_state import MISSED, PARTS, BodyState, presence
from synthgen.registration.verdict import Judgement
from synthgen.sampling.sequence import PoseSequence, SequenceSettings, sample_sequence
from synthgen.sampling.streams import stream
from tests.registration import hands
from tests.registration.hands import surface, truth
from tests.registration.test_fit import cold

FRAMES, GAP = 5, (1, 3)
EMPTY = (np.zeros((0, 3)), np.zeros((0, 3)))


@lru_cache(maxsize=1)
def sequence() -> PoseSequence:
    settings = SequenceSettings(FRAMES, missing={"left": GAP})
    return sample_sequence(load("cc0-body"), settings, rng=stream(3, "sample", 0, 0, "track test"))


@lru_cache(maxsize=1)
def scans() -> list[tuple[np.ndarray, np.ndarray]]:
    model, rng, found = load("cc0-body"), stream(4, "sample", 0, 0, "track test"), []
    for k, vertices in enumerate(sequence().vertices(model)):
        lost = {side: 1.0 for side, gone in sequence().missing.items() if gone[k]}
        settings = BodyScanSettings(points=45_000, lost=lost)
        scan = simulate_body_scan(model, vertices, settings, rng=rng)
        found.append((scan.points, scan.normals))
    return found


def start() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A rough start: the first frame's pose, some degrees off."""
    pose = sequence().pose[0].copy()
    pose[1:] += stream(5, "sample", 0, 0, "track test").normal(0, 0.05, pose[1:].shape)
    return sequence().shape, pose, sequence().translation[0] + 0.01


@lru_cache(maxsize=1)
def tracked() -> Track:
    return track(scans(), load("cc0-body"), start(), shape=sequence().shape)


def errors_mm(found: Track) -> dict[str, np.ndarray]:
    surface = body_surface(load("cc0-body"))
    fitted = np.array([fit.vertices for fit in found.fits])
    off = 1e3 * np.linalg.norm(fitted - sequence().vertices(load("cc0-body")), axis=2)
    hands = {side: hand_vertices(surface, side) for side in ("left", "right")}
    body = np.setdiff1d(np.arange(off.shape[1]), np.concatenate(list(hands.values())))
    return {"body": off[:, body].mean(1), **{s: off[:, ids].mean(1) for s, ids in hands.items()}}


def test_smoke_a_body_and_a_hand_that_goes_missing() -> None:
    found, off = tracked(), errors_mm(tracked())
    assert off["body"].mean() < 0.5
    assert off["right"].mean() < 2.5
    assert off["left"][0] < 2.5
    assert off["left"][-1] < 5
    gone = [GAP[0] <= k < GAP[1] for k in range(FRAMES)]
    assert [f.verdict == "unobserved" for f in found.fits] == gone
    assert {f.reason for f in found.fits} == {"", "hole(left_hand)"}
    assert [f.report["unseen_frames"]["left"] for f in found.fits] == [0, 1, 2, 0, 0]
    assert found.report["verdicts"] == {"pass": 3, "unobserved": 2, "fail": 0}


def test_properties_a_missing_hand_is_held_and_the_shape_kept() -> None:
    model, fits = load("cc0-body"), tracked().fits
    names = model.joint_names
    own = [k for k, n in enumerate(names) if n.startswith("left_") and n[-1] in "123"]
    own.append(names.index("left_wrist"))
    for k in range(*GAP):
        assert np.array_equal(fits[k].pose[own], fits[GAP[0] - 1].pose[own])
        assert not np.array_equal(fits[k].pose, fits[GAP[0] - 1].pose)
    assert all(np.array_equal(fit.shape, sequence().shape) for fit in fits)


def test_properties_the_first_frames_tell_the_shape() -> None:
    rough = (np.zeros(16), *start()[1:])
    found = track(scans()[:2], load("cc0-body"), rough, first=2)
    assert np.abs(found.shape - sequence().shape).mean() < 0.08
    assert np.abs(found.shape).mean() > 0.3
    assert found.report["cpu_s"]["shape"] > 0


def test_properties_frames_that_cannot_be_fitted_are_held() -> None:
    """An empty frame and one in millimetres do not end the run."""
    good = scans()[0]
    frames = [good, EMPTY, (1e3 * good[0], good[1]), good]
    seen: list[tuple[int, str]] = []
    found = track(frames, load("cc0-body"), start(), shape=sequence().shape,
                  done=lambda k, fit: seen.append((k, fit.reason)))  # fmt: skip
    assert seen == [(0, ""), (1, "no_points"), (2, "scale"), (3, "")]
    assert np.array_equal(found.fits[2].pose, found.fits[0].pose)
    assert found.report["followed"] == [True, False, False, True]
    assert "multiply the points by 0.001" in found.fits[2].report["message"]


def test_reference_states_of_the_truth() -> None:
    """At the truth hands that are there are present, and nothing is unexplained."""
    surface, truth = body_surface(load("cc0-body")), sequence()
    for k in (0, GAP[0]):
        placed = surface.at(surface.pack(truth.shape, truth.pose[k], truth.translation[k]))
        state = BodyState.of(placed, Scan(*scans()[k]))
        assert 0.8 < state.present["right"] < 1.3
        assert (state.present["left"] > 0.8) == (k == 0)
        assert state.explained > 0.98
        assert 6e-4 < state.noise_m < 1e-3
        assert not state.missed(("right",))
        other = surface.at(surface.pack(truth.shape, np.roll(truth.pose[k], 1, axis=0),
                                        truth.translation[k]))  # fmt: skip
        assert (
            BodyState.of(other, Scan(*scans()[k])).judged({"left": 0, "right": 0}).verdict == "fail"
        )


def state(**changes: Any) -> BodyState:
    plain = BodyState({"left": 1.0, "right": 1.0}, np.full(len(PARTS), 10_000),
                      np.full(len(PARTS), 0.01), 0.99, 0.01, 1e-3)  # fmt: skip
    return replace(plain, **changes)


def test_properties_judgements() -> None:
    seen, left_gone = {"left": 0, "right": 0}, {"left": 3, "right": 0}
    hand_off = np.full(len(PARTS), 0.01)
    hand_off[PARTS.index("left_hand")] = MISSED + 0.02
    assert state().judged(seen) == Judgement("pass")
    assert state(unexplained=hand_off).judged(seen).text == "part_missed(left_hand)"
    assert state(unexplained=hand_off).judged(left_gone) == Judgement(
        "unobserved", "hole", ("left_hand",)
    )
    few = np.full(len(PARTS), 60)
    assert state(unexplained=hand_off, points=few).judged(seen) == Judgement("pass")
    assert state(far=0.5).judged(seen).reason == "background"
    assert state(explained=0.5).judged(seen).reason == "not_converged"
    assert state(unexplained=hand_off).missed(("left", "right")) == ("left",)
    assert state().better(state(unexplained=hand_off), ("left",)) == ("left",)
    assert not state().better(state(), ("left",))


def test_reference_presence_counts_points_of_the_hand_alone() -> None:
    surface, truth = body_surface(load("cc0-body")), sequence()
    placed = surface.at(surface.pack(truth.shape, truth.pose[0], truth.translation[0]))
    ids = hand_vertices(surface, "right")
    scan = Scan(placed.vertices[ids], placed.normals[ids])
    crops = (np.zeros(0, np.int64), np.arange(len(ids)))
    share = presence(placed, scan, crops)
    assert share["left"] == 0
    assert share["right"] > 10  # nothing but a hand: many times its share of a body


class _Fake:
    """Follows a number that grows by 0.1 a frame; scans are lists of what happens."""

    sides = ("left",)
    surface = SimpleNamespace(n=4, shape=slice(0, 1))

    def __init__(self) -> None:
        self.starts: list[np.ndarray] = []
        self.begun = 0

    def scan(self, points: Any, normals: Any) -> Any:
        return SimpleNamespace(points=points)

    def inspect(self, scan: Any) -> Finding | None:
        return None

    def begin(self, points: Any, normals: Any, start: Any) -> Fit:
        self.begun += 1
        return self.fitted(np.zeros(4), Judgement("pass"), {})

    def vector(self, fit: Fit) -> np.ndarray:
        return fit.pose.copy()

    def fitted(self, x: np.ndarray, judgement: Judgement, report: dict[str, Any]) -> Fit:
        none = np.zeros(3)
        return Fit(x[:1], x.copy(), none, None, none, none, judgement.verdict, judgement.text,
                   report, load("cc0-body"))  # fmt: skip

    def hand(self, side: str) -> np.ndarray:
        return np.array([3])

    def follow(self, scan: Any, previous: Any, start: Any, unseen: Any, **_: Any) -> Frame:
        self.starts.append(start.copy())
        if scan.points == "bad" or (scan.points == "jump" and previous[1] != 0):
            return Frame(start, Judgement("fail", "not_converged"), unseen, {})
        gone = {"left": unseen["left"] + 1 if scan.points == "gone" else 0}
        moved = np.array([0.0, 0.1, 2.0, 0.0 if gone["left"] else 0.1 * (1 + unseen["left"])])
        return Frame(previous + moved, Judgement("pass"), gone, {})


def walked(words: list[Any]) -> Iterator[tuple[_Fake, Fit]]:
    fake = _Fake()
    walk = _Walk(fake, "cold", np.array([0.5]))  # type: ignore[arg-type]
    for word in words:
        yield fake, walk.step(word, None)


def test_properties_frames_begin_where_the_motion_leads() -> None:
    *_, (fake, last) = walked(["ok", "ok", "gone", "gone", "ok", "ok"])
    np.testing.assert_allclose(fake.starts[1] - fake.starts[0], [0, 0.2, 2.0, 0.2])
    # Jumps are no motion, and after a gap the hand's step is shared among the frames.
    np.testing.assert_allclose(fake.starts[-1], last.pose + [0, 0, -2.0, 0])
    assert last.pose[0] == 0.5


def test_properties_a_lost_subject_is_begun_again() -> None:
    steps = list(walked(["ok", "ok", "bad", "jump", "ok"]))
    fake = steps[-1][0]
    assert [fit.report["followed"] for _, fit in steps] == [True, True, False, True, True]
    assert [fit.report["start"] for _, fit in steps] == [
        "frame before", "frame before", "afresh", "afresh", "frame before",
    ]  # fmt: skip
    assert fake.begun == 3
    assert np.array_equal(steps[1][1].pose, steps[2][1].pose)
    np.testing.assert_allclose([fit.pose[1] for _, fit in steps], [0.1, 0.2, 0.2, 0.1, 0.2])


def test_properties_a_late_beginning_freezes_its_shape() -> None:
    walk = _Walk(_Fake(), "cold", None, freeze=True)  # type: ignore[arg-type]
    fits = [walk.step(word, None) for word in ("ok", "ok")]
    assert walk.betas is not None
    assert fits[1].shape == fits[0].shape == walk.betas


@pytest.mark.parametrize(
    ("verdict", "reason", "lost"),
    [
        ("pass", "", False),
        ("unobserved", "hole(left_hand)", False),
        ("fail", "part_missed(left_hand, right_hand)", False),
        ("fail", "part_missed(left_hand, left_arm)", True),
        ("fail", "finger_missed(index)", False),
        ("fail", "cold_start_failed", True),
    ],
)
def test_reference_what_is_lost(verdict: str, reason: str, lost: bool) -> None:
    assert is_lost(verdict, reason) == lost


@lru_cache(maxsize=2)
def hand_scans(flip: bool = False) -> list[tuple[np.ndarray, np.ndarray]]:
    model = load("cc0-hand")
    rng = stream(8, "sample", 0, 0, "track test")
    moving = sample_sequence(model, SequenceSettings(3), rng=rng)
    sign = np.array([-1.0 if flip else 1.0, 1, 1])
    found = []
    for vertices in moving.vertices(model):
        settings = ScanSettings(views=6, points=20_000, holes=0, pixels=200)
        points, normals, _ = simulate_scan(vertices, model.faces, settings, rng=rng)
        found.append((points * sign, normals * sign))
    return found


def test_smoke_a_left_hand_alone() -> None:
    first, second, third = hand_scans(flip=True)
    found = track([first, second, EMPTY, third], load("cc0-hand"), first=1, coupled=True)
    assert [f.verdict for f in found.fits] == ["pass", "pass", "unobserved", "pass"]
    assert all(f.hand == "left" for f in found.fits)
    assert all(np.array_equal(f.shape, found.shape) for f in found.fits)
    assert found.fits[2].reason == "hole(hand)"
    assert np.array_equal(found.fits[2].vertices, found.fits[1].vertices)
    rng = stream(8, "sample", 0, 0, "track test")
    truth = sample_sequence(load("cc0-hand"), SequenceSettings(3), rng=rng).vertices(
        load("cc0-hand")
    )
    for fit, vertices in zip([found.fits[k] for k in (0, 1, 3)], truth, strict=True):
        error = 1e3 * np.linalg.norm(fit.vertices - vertices * [-1, 1, 1], axis=1)
        assert error.mean() < 0.6
        assert fit.free_vertices is not None
        assert np.linalg.norm(fit.free_vertices - fit.vertices, axis=1).mean() < 1e-3


def test_properties_a_hand_keeps_its_shape_whatever_it_starts_from() -> None:
    """Fingers that were begun afresh come with a shape of their own; a frozen one stays."""
    x = hands.truth()
    other = x.copy()
    other[hands.surface().shape] += 0.5
    follower = HandFollower(hands.model(), "right")
    frame = follower.follow(hands.scan(), x, other, {"hand": 0}, shape_free=False)
    assert frame.judgement.verdict == "pass"
    np.testing.assert_allclose(frame.x[hands.surface().shape], x[hands.surface().shape], atol=1e-9)


def test_properties_a_missed_finger_still_tells_the_side(monkeypatch: pytest.MonkeyPatch) -> None:
    missed = replace(cold(), verdict="fail", reason="finger_missed(index)", hand="left")
    monkeypatch.setattr("synthgen.registration.tracking_hand.fit", lambda *_, **__: missed)
    follower = HandFollower(hands.model(), None)
    follower.begin(*hands.scanned(), "cold")
    assert follower.side == follower.asked == "left"


def test_edge_arguments() -> None:
    body = load("cc0-body")
    with pytest.raises(ShapeError, match="no frames"):
        track([], body)
    with pytest.raises(ShapeError, match="first=0"):
        track([EMPTY], body, first=0)
    with pytest.raises(ShapeError, match=r"up to \(16,\)"):
        track([EMPTY], body, shape=np.zeros(40))
    with pytest.raises(ShapeError, match="normals have shape"):
        track([(np.ones((50_000, 3)), np.ones((10, 3)))], body)
    with pytest.raises(ModelError):
        track([EMPTY], replace(body, family="star"))


def test_edge_nothing_but_empty_frames() -> None:
    found = track([EMPTY, EMPTY], load("cc0-body"))
    assert [f.reason for f in found.fits] == ["no_points"] * 2
    assert found.report["followed"] == [False, False]


@lru_cache(maxsize=1)
def other() -> tuple[PoseSequence, list[np.ndarray], list[tuple[np.ndarray, np.ndarray]]]:
    """A body whose shape the model does not have: its poses, vertices and scans."""
    model, rng = load("cc0-body"), stream(6, "sample", 0, 0, "track test")
    true = replace(model, v_template=with_shape(model.v_template, 1.7e-3, rng=rng), digest="other")
    poses = sample_sequence(true, SequenceSettings(3), rng=rng)
    vertices = [v.astype(np.float64) for v in poses.vertices(true)]
    settings = BodyScanSettings(points=45_000)
    found = [simulate_body_scan(model, v, settings, rng=rng) for v in vertices]
    return poses, vertices, [(s.points, s.normals) for s in found]


def test_properties_a_subject_beside_the_model_has_its_own_template() -> None:
    model, (poses, true, frames) = load("cc0-body"), other()
    start = poses.shape, poses.pose[0], poses.translation[0]
    hands = np.concatenate([hand_vertices(body_surface(model), s) for s in ("left", "right")])
    body = np.setdiff1d(np.arange(len(model.v_template)), hands)
    off = {}
    for template in (False, None):
        found = track(frames, model, start, first=2, template=template)
        assert (found.offset is None) == (template is False)
        faces = np.ascontiguousarray(model.faces, dtype=np.int64)
        squared = point_mesh_squared_distance(true[2][body], found.fits[2].vertices, faces)[0]
        off[template] = 1e3 * float(np.sqrt(squared).mean())
    assert off[None] < 0.45
    assert off[None] < 0.6 * off[False]
    assert found.offset is not None
    assert np.abs(found.offset[hands]).max() == 0
    posed = found.model.evaluate(found.shape[None], found.fits[2].pose[None],
                                 found.fits[2].translation[None])  # fmt: skip
    np.testing.assert_allclose(posed.vertices[0], found.fits[2].vertices, atol=1e-5)
    assert found.model.digest != model.digest


def test_properties_a_subject_of_the_model_keeps_its_template() -> None:
    assert track(scans()[:2], load("cc0-body"), start(), first=2).offset is None


def test_properties_a_sequence_goes_on_from_any_place() -> None:
    """The same bits, with a subject's own template too."""
    model, (poses, _, frames) = load("cc0-body"), other()
    start, places = (poses.shape, poses.pose[0], poses.translation[0]), []
    whole = track(frames, model, start, first=1, template=True, paused=places.append)
    rest = track(frames[1:], model, start, resume=places[0])
    for one, two in zip(whole.fits[1:], rest.fits, strict=True):
        np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(whole.shape, rest.shape)
    np.testing.assert_array_equal(whole.offset, rest.offset)


@pytest.mark.parametrize("side", ["left", "right"])
def test_properties_a_hand_has_its_own_template(side: str) -> None:
    """Of a left hand too, whose offset is kept as a right hand's."""
    model, rng = load("cc0-hand"), stream(8, "sample", 0, 0, "track test")
    flip = np.array([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    vertices = with_detail(surface().at(truth()).vertices, model.faces, 6e-4, rng=rng)
    points, normals, _ = simulate_scan(vertices, model.faces, ScanSettings(points=15_000), rng=rng)
    shape, pose, translation = surface().unpack(truth())
    start = shape, pose if side == "right" else mirror_pose(pose), translation * flip
    frames = [(points * flip, normals * flip)] * 2
    off = []
    for template in (False, True):
        found = track(frames, model, start, side, first=1, template=template)
        faces = np.ascontiguousarray(model.faces, dtype=np.int64)
        squared = point_mesh_squared_distance(vertices, found.fits[1].vertices * flip, faces)[0]
        off.append(float(np.sqrt(squared).mean()))
        assert found.fits[1].hand == side
    assert off[1] < 0.8 * off[0]
