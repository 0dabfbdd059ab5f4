"""Fitting from given and cold starts, both sides, and scans that cannot be fitted."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import synthgen
from synthgen.errors import ModelError, ShapeError
from synthgen.models import mirror_model
from synthgen.registration import REASONS, Fit, fit, fit_many
from synthgen.registration.scan import scan_of
from synthgen.registration.simulated import ScanSettings, simulate_scan, with_detail
from synthgen.registration.statistics import PARTS
from tests.registration.hands import error_mm, model, perturbed, rng, scan, scanned, surface, truth

FLIP = np.array([-1.0, 1.0, 1.0])
INDEX = np.isin(model().weights.argmax(axis=1), [1, 2, 3])


@lru_cache(maxsize=8)
def cold(number: int = 7) -> Fit:
    return fit(*scanned(number), model(), "cold", "right")


def test_smoke_public_names() -> None:
    assert synthgen.registration.fit is fit


def test_smoke_result() -> None:
    found = cold()
    assert found.shape.shape == (10,)
    assert found.pose.shape == (16, 3)
    assert found.translation.shape == (3,)
    assert found.vertices.shape == (surface().n_vertices, 3)
    assert found.expression is None
    assert found.hand == "right"
    assert found.report["statistics"]["explained"] > 0.98


@pytest.mark.parametrize("number", [3, 5, 7])
def test_properties_cold_start_finds_the_hand(number: int) -> None:
    found = cold(number)
    assert found.verdict in ("pass", "unobserved"), found.reason
    assert error_mm(found.vertices, number) < 0.5


def test_properties_perturbed_start_gives_the_same_hand() -> None:
    found = fit(*scanned(), model(), perturbed(), "right")
    assert found.verdict == "pass"
    assert error_mm(found.vertices) < 0.2
    np.testing.assert_allclose(found.vertices, cold().vertices, atol=2e-4)


def test_properties_parameters_are_those_of_the_vertices() -> None:
    found = cold()
    posed = found.model.evaluate(found.shape[None], found.pose[None], found.translation[None])
    np.testing.assert_allclose(posed.vertices[0], found.vertices, atol=1e-6)
    np.testing.assert_allclose(posed.joints[0], found.joints, atol=1e-6)


def test_properties_predicted_sd_belongs_to_the_error() -> None:
    """Errors are of the size predicted: within a factor of about three."""
    found = cold()
    off = np.linalg.norm(found.vertices - surface().at(truth()).vertices, axis=1)
    ratio = np.sqrt(np.mean(off**2)) / np.sqrt(np.mean(found.vertex_sd_m**2))
    assert 0.3 < ratio < 3


def test_properties_unknown_side_is_found() -> None:
    points, normals = scanned()
    for flip, side in ((np.ones(3), "right"), (FLIP, "left")):
        found = fit(points * flip, normals * flip, model())
        assert (found.hand, found.verdict) == (side, "pass")
        assert found.model.hand == side
        assert error_mm(found.vertices * flip) < 0.2
        posed = found.model.evaluate(found.shape[None], found.pose[None], found.translation[None])
        np.testing.assert_allclose(posed.vertices[0], found.vertices, atol=1e-6)


def test_properties_one_view_tells_the_side() -> None:
    """The mirrored hand fits most of these points: it fails by two fingers only."""
    vertices = surface().at(truth(2)).vertices
    settings = ScanSettings(views=1, points=20_000, pixels=200)
    points, normals, _ = simulate_scan(vertices, surface().faces, settings, rng=rng("one2"))
    found = fit(points, normals, model())
    assert (found.hand, found.verdict) == ("right", "unobserved")


def test_properties_left_model_fits_left_hands() -> None:
    points, normals = scanned()
    found = fit(points * FLIP, normals * FLIP, mirror_model(model()), "cold", "left")
    assert (found.hand, found.verdict) == ("left", "pass")
    assert error_mm(found.vertices * FLIP) < 0.2


def test_properties_wrong_side_is_named() -> None:
    points, normals = scanned()
    found = fit(points * FLIP, normals * FLIP, model(), "cold", "right")
    assert (found.verdict, found.reason) == ("fail", "other_hand")
    assert "hand left" in found.report["message"]


def test_properties_the_other_side_must_explain_more_to_be_named() -> None:
    """Two views that miss the thumb: mirrored, the hand fits worse, with the thumb out of sight."""
    vertices = surface().at(truth(8)).vertices
    settings = ScanSettings(views=2, points=20_000, pixels=200, noise_m=1e-3)
    points, normals, _ = simulate_scan(vertices, surface().faces, settings, rng=rng("im82"))
    found = fit(points, normals, model(), perturbed(8), "right")
    assert (found.verdict, found.reason) == ("fail", "finger_missed(thumb)")
    found = fit(points, normals, model())
    assert (found.hand, found.reason) == ("right", "finger_missed(thumb)")


@pytest.mark.parametrize("number", [0, 3, 4])
def test_properties_one_view_tells_a_wrong_side(number: int) -> None:
    """Where the right side is unobserved in part, too: what is seen is explained."""
    vertices = surface().at(truth(number)).vertices
    settings = ScanSettings(views=1, points=20_000, pixels=200)
    points, normals, _ = simulate_scan(vertices, surface().faces, settings, rng=rng(f"ov{number}1"))
    found = fit(points, normals, model(), "cold", "left")
    assert (found.verdict, found.reason) == ("fail", "other_hand")


def test_properties_normals_may_be_missing() -> None:
    points, _ = scanned()
    found = fit(points, None, model(), "cold", "right")
    assert found.verdict == "pass"
    assert error_mm(found.vertices) < 0.5


def test_properties_turning_the_scan_turns_the_fit() -> None:
    from scipy.spatial.transform import Rotation

    turn = Rotation.random(rng=rng("turn")).as_matrix()
    points, normals = scanned()
    found = fit(points @ turn.T + 0.5, normals @ turn.T, model(), "cold", "right")
    np.testing.assert_allclose(found.vertices, cold().vertices @ turn.T + 0.5, atol=3e-4)


def test_properties_same_input_same_output() -> None:
    again = fit(*scanned(), model(), "cold", "right")
    np.testing.assert_array_equal(again.vertices, cold().vertices)


@pytest.mark.parametrize("preset", ["accurate", "paper"])
def test_properties_other_presets(preset: str) -> None:
    found = fit(*scanned(), model(), perturbed(), "right", preset=preset)
    assert found.verdict == "pass", found.reason
    assert error_mm(found.vertices) < 0.2


def test_properties_pca_option_stays_in_its_span() -> None:
    found = fit(*scanned(), model(), perturbed(), "right", components=12)
    directions, mean = model().hands_components, model().hands_mean
    assert directions is not None
    assert mean is not None
    off = found.pose[1:].ravel() - mean.ravel()
    inside = np.linalg.lstsq(directions[:12].T, off, rcond=None)[0] @ directions[:12]
    np.testing.assert_allclose(off, inside, atol=1e-9)
    assert error_mm(found.vertices) < 3
    assert found.report["statistics"]["pending_step"] < 1e-3


def without_index(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A scan of a hand whose index finger is cut away."""
    vertices = surface().at(x).vertices
    settings = ScanSettings(points=20_000, pixels=200)
    points, normals, _ = simulate_scan(vertices, surface().faces, settings, rng=rng("cut"))
    far: Any = cKDTree(vertices[INDEX]).query(points)[0] > 0.004
    return points[far], normals[far]


def test_properties_keypoints_and_a_protocol_tell_of_a_hidden_finger() -> None:
    x = truth().copy()
    x[surface().fingers.start + 2] -= 0.5
    placed, (_, pose, _) = surface().at(x), surface().unpack(x)
    known: list[dict[str, Any]] = [
        {}, {"keypoints": (np.arange(1, 4), placed.joints[1:4])}, {"pose_prior": (pose, 0.02)},
    ]  # fmt: skip
    off = []
    for given in known:
        found = fit(*without_index(x), model(), perturbed(), "right", **given)
        off.append(1e3 * np.linalg.norm(found.vertices - placed.vertices, axis=1)[INDEX].mean())
    plain, keypoints, protocol = off
    assert plain > 10
    assert keypoints < 0.25 * plain
    assert protocol < 0.1 * plain


def test_properties_a_hidden_finger_is_unobserved() -> None:
    """Points of one finger cut away: the fit may not pass as if it had seen it."""
    found = fit(*without_index(truth()), model(), "cold", "right")
    assert (found.verdict, found.reason) == ("unobserved", "hole(index)")


def bumpy_scan(number: int, amplitude_m: float, first: int | None = None) -> tuple[Any, Any]:
    """A scan of a hand with detail that no model has, whole or without a finger from a joint on."""
    vertices = surface().at(truth(number)).vertices
    bumpy = with_detail(vertices, surface().faces, amplitude_m, rng=rng("d"))
    settings = ScanSettings(views=6, points=20_000, pixels=200)
    points, normals, _ = simulate_scan(bumpy, surface().faces, settings, rng=rng("s"))
    if first is None:
        return points, normals
    part, last = model().weights.argmax(axis=1), 3 * ((first + 2) // 3)
    gone: Any = cKDTree(bumpy[(part >= first) & (part <= last)]).query(points)[0] < 0.004
    return points[~gone], normals[~gone]


@pytest.mark.parametrize(
    ("number", "amplitude_m", "first", "finger"),
    [(5, 6e-4, 1, "index"), (7, 6e-4, 13, "thumb"), (7, 6e-4, 14, "thumb"),
     (1, 3e-4, 6, "middle"), (5, 3e-4, 6, "middle"), (4, 3e-4, 9, "pinky"),
     (5, 1e-6, 6, "middle")],
)  # fmt: skip
def test_properties_a_hidden_finger_of_a_bumpy_hand_is_unobserved(
    number: int, amplitude_m: float, first: int, finger: str
) -> None:
    """Detail that no model has makes everything uncertain, but no missing finger a seen one."""
    whole = fit(*bumpy_scan(number, amplitude_m), model(), perturbed(number), "right")
    assert whole.verdict == "pass"
    taken = bumpy_scan(number, amplitude_m, first)
    found = fit(*taken, model(), perturbed(number), "right")
    assert (found.verdict, found.reason) == ("unobserved", f"hole({finger})")


@pytest.mark.prove
def test_properties_no_fingertip_of_a_bumpy_hand_is_missed_in_a_pass() -> None:
    """Of whole hands, but for fists, none is unobserved."""
    whole, cut = [], []
    for number in (1, 2, 4, 5, 6, 7, 8, 9):
        for k, amplitude_m in enumerate((3e-4, 6e-4, 1e-3)):
            whole.append(fit(*bumpy_scan(number, amplitude_m), model(), perturbed(number), "right"))
            for finger in ((number + k) % 5, (number + k + 2) % 5):
                taken = bumpy_scan(number, amplitude_m, 3 * finger + 3)
                found = fit(*taken, model(), perturbed(number), "right")
                cut.append((found.verdict, PARTS[finger + 1] in found.reason))
    assert [one.verdict for one in whole].count("pass") >= 23
    assert len(cut) == 48
    assert all(verdict == "fail" or named for verdict, named in cut), cut
    assert ("pass", False) not in cut


def test_properties_batches_are_single_fits() -> None:
    both = fit_many([scanned(), scanned(5)], model(), hand="right")
    np.testing.assert_array_equal(both[0].vertices, cold().vertices)


def bad(name: str) -> tuple[Any, Any]:
    points, normals = scanned()
    table = rng("table").uniform(-0.5, 0.5, (40_000, 3)) * [1, 0, 1] + points.mean(axis=0)
    up = np.tile([0.0, 1.0, 0.0], (len(table), 1))
    return {
        "no_points": (np.zeros((0, 3)), None),
        "no_points_nan": (np.full((500, 3), np.nan), None),
        "scale": (points * 1000, normals),
        "scale_inch": (points / 0.0254, normals),
        "flipped_normals": (points, -normals),
        "two_hands": (np.concatenate([points, points + [0.35, 0, 0]]),
                      np.concatenate([normals, normals])),
        "background": (np.concatenate([points, table]), np.concatenate([normals, up])),
    }[name]  # fmt: skip


@pytest.mark.parametrize(
    "name",
    ["no_points", "no_points_nan", "scale", "scale_inch", "flipped_normals", "two_hands",
     "background"],
)  # fmt: skip
def test_edge_bad_scans_fail_with_their_reason(name: str) -> None:
    found = fit(*bad(name), model(), "cold", "right")
    assert found.verdict == "fail"
    assert name.startswith(found.reason)
    assert found.reason in REASONS
    assert found.report["message"]


def swollen(*fingers: int) -> tuple[Any, Any]:
    """A scan of a hand with bandaged fingers (MANO order): skin 2.5 mm outside the model's."""
    from synthgen.geometry.normals import vertex_normals

    vertices = surface().at(truth()).vertices
    part = (model().weights.argmax(axis=1) + 2) // 3 - 1
    thick = np.where(np.isin(part, fingers), 0.0025, 0.0)
    bandaged = vertices + thick[:, None] * vertex_normals(vertices, surface().faces)
    settings = ScanSettings(points=20_000, pixels=200)
    return simulate_scan(bandaged, surface().faces, settings, rng=rng("bandage"))[:2]


def test_edge_a_bandaged_finger_is_missed() -> None:
    found = fit(*swollen(0), model(), perturbed(), "right")
    assert (found.verdict, found.reason) == ("fail", "finger_missed(index)")


def test_edge_two_odd_fingers_may_be_swapped() -> None:
    found = fit(*swollen(1, 2), model(), perturbed(), "right")
    assert found.verdict == "fail"
    assert found.reason in ("finger_swap(middle, pinky)", "finger_swap(pinky, middle)")


def test_edge_two_thick_neighbours_are_no_hand() -> None:
    """Index and middle finger: a shape of thick fingers nearly explains them, but nobody has it."""
    found = fit(*swollen(0, 1), model(), perturbed(), "right")
    assert (found.verdict, found.reason) == ("fail", "shape_limit")


def test_edge_a_giant_shape_is_named() -> None:
    x = truth().copy()
    x[surface().shape] = 0
    x[surface().shape.start + 1] = 7.0
    vertices = surface().at(x).vertices
    taken = simulate_scan(vertices, surface().faces, ScanSettings(points=20_000, pixels=200),
                          rng=rng("giant"))  # fmt: skip
    found = fit(*taken[:2], model(), perturbed(), "right")
    assert (found.verdict, found.reason) == ("fail", "shape_limit")


@pytest.mark.parametrize(("noise_m", "reason"), [(1.7e-3, ""), (2.4e-3, "noise_above_spec")])
def test_edge_a_bad_sensor_is_named(noise_m: float, reason: str) -> None:
    vertices = surface().at(truth()).vertices
    settings = ScanSettings(points=20_000, pixels=200, noise_m=noise_m)
    points, normals, _ = simulate_scan(vertices, surface().faces, settings, rng=rng("bad sensor"))
    found = fit(points, normals, model(), perturbed(), "right")
    assert found.report["statistics"]["noise_mm"] == pytest.approx(1e3 * noise_m, rel=0.05)
    assert error_mm(found.vertices) < 1.5
    assert found.reason == reason
    assert ("points scatter" in found.report.get("message", "")) == bool(reason)


def test_edge_a_fit_that_was_cut_short_says_so() -> None:
    from dataclasses import replace

    from synthgen.registration import schedule
    from synthgen.registration.fit import _Request
    from synthgen.registration.search import finish

    settings = _Request(model(), "fast", False, None, None, None, 0.0).settings("right")
    hurried = schedule.Preset("hurried", (replace(schedule.LAST, iterations=0),))
    x = truth().copy()
    x[surface().translation] += [0, 0, 4e-4]
    found = finish(replace(settings, preset=hurried), scan(), x, "given")
    assert found.judgement is not None
    assert found.judgement.text == "not_converged"


def test_properties_what_few_points_lack_is_not_counted_twice() -> None:
    """A misfit takes from the points that a scan has, not from those that a stage would like."""
    from synthgen.registration.fit import _Request
    from synthgen.registration.search import finish

    settings = _Request(model(), "fast", False, None, None, None, 0.0).settings("right")
    vertices = with_detail(surface().at(truth()).vertices, surface().faces, 5e-4, rng=rng("bumps"))
    drawn = ScanSettings(points=20_000, pixels=200)
    points, normals, _ = simulate_scan(vertices, surface().faces, drawn, rng=rng("bumpy scan"))
    inflation = []
    for n in (5_000, 20_000):
        found = finish(settings, scan_of(points[:n], normals[:n]), truth(), "given").statistics
        assert found is not None
        inflation.append(found.inflation)
    assert inflation[0] > 3
    assert inflation[0] < 0.5 * inflation[1]


def test_edge_some_nan_points_do_no_harm() -> None:
    points, normals = (a.copy() for a in scanned())
    points[::50] = np.nan
    found = fit(points, normals, model(), "cold", "right")
    assert found.verdict == "pass"
    assert found.report["points_dropped"] == len(points[::50])


def test_edge_no_hand_at_all_fails() -> None:
    ball = rng("ball").standard_normal((8000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    found = fit(0.06 * ball, ball, model(), "cold", "right")
    assert found.verdict == "fail"


@pytest.mark.parametrize("shape", ["three spots", "a line"])
def test_edge_what_is_no_surface_fails(shape: str) -> None:
    """No crash where nearly nothing determines a hand."""
    random = rng("no surface")
    points = {
        "three spots": np.repeat(random.random((3, 3)), 400, axis=0),
        "a line": random.random((1200, 1)) * [1, 0, 0],
    }[shape]
    found = fit(0.15 * points, None, model(), "cold", "right")
    assert found.verdict == "fail"
    assert found.reason.partition("(")[0] in REASONS


def test_edge_wrong_arguments() -> None:
    points, normals = scanned()
    with pytest.raises(ShapeError, match="start="):
        fit(points, normals, model(), "warm")
    with pytest.raises(ShapeError, match="hand="):
        fit(points, normals, model(), "cold", "both")
    with pytest.raises(ShapeError, match="start has shape"):
        fit(points, normals, model(), (np.zeros(10), np.zeros(3), np.zeros(3)))
    with pytest.raises(ShapeError, match="not finite"):
        fit(points, normals, model(), (np.full(10, np.nan), np.zeros((16, 3)), np.zeros(3)))
    with pytest.raises(ModelError, match="hand"):
        fit(points, normals, object())  # type: ignore[arg-type]
