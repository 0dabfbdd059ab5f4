"""Bodies from cold and given starts, missing hands, and scans that cannot be fitted."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from synthgen.errors import ModelError, ShapeError
from synthgen.models import separate
from synthgen.registration import REASONS, Fit, fit, track
from synthgen.registration.body_fit import start_vector
from synthgen.registration.body_statistics import PARTS, part_of_vertex
from synthgen.registration.coupled import couple
from synthgen.registration.simulated import ScanSettings, simulate_scan
from synthgen.registration.simulated_body import BodyScanSettings, simulate_body_scan
from tests.registration import hands
from tests.registration.bodies import (
    NAMES,
    errors_mm,
    model,
    rng,
    scanned,
    surface,
    truth,
)


@lru_cache(maxsize=8)
def cold(number: int = 0, name: str = "cc0-body", lost: float = 0.0) -> Fit:
    return fit(*scanned(number, name, lost), model(name))


def parameters(found: Fit) -> tuple[Any, ...]:
    return found.shape[None], found.pose[None], found.translation[None]


def test_smoke_result() -> None:
    found = cold()
    assert found.shape.shape == (16,)
    assert found.pose.shape == (52, 3)
    assert found.hand is None
    assert found.expression is None
    assert found.vertex_sd_m.shape == (13_380,)
    assert set(found.report["statistics"]["parts"]) == set(PARTS)


@pytest.mark.parametrize(("number", "name"), [(0, "cc0-body"), (1, "cc0-body"), (0, "cc0-supr")])
def test_properties_cold_start_finds_the_body(number: int, name: str) -> None:
    found = cold(number, name)
    assert found.verdict == "pass", found.reason
    off = errors_mm(found.vertices, number, name)
    assert off["body"] < 0.8
    assert off["left"] < 2.5
    assert off["right"] < 2.5


@pytest.mark.parametrize("name", NAMES)
def test_properties_parameters_are_those_of_the_vertices(name: str) -> None:
    found = cold(0, name)
    expression = None if found.expression is None else found.expression[None]
    posed = model(name).evaluate(*parameters(found), expression)
    np.testing.assert_allclose(posed.vertices[0], found.vertices, atol=1e-5)
    np.testing.assert_allclose(posed.joints[0], found.joints, atol=1e-5)


def test_properties_supr_has_an_expression_and_still_eyes() -> None:
    found, names = cold(0, "cc0-supr"), model("cc0-supr").joint_names
    assert found.expression is not None
    assert found.expression.shape == (47,)
    assert np.abs(found.expression).max() > 0.1
    assert not found.pose[names.index("left_eye")].any()


def test_properties_a_given_start_is_cheaper() -> None:
    shape, pose, translation = surface().unpack(truth())
    pose[1:] += rng("start").normal(0, 0.1, pose[1:].shape)
    found = fit(*scanned(), model(), (0 * shape, pose, translation + 0.02))
    assert found.verdict == "pass"
    assert found.report["start"] == "given"
    assert errors_mm(found.vertices)["body"] < 0.8
    assert len(found.report["stages"]) < len(cold().report["stages"])


def test_properties_a_useless_start_is_given_up() -> None:
    start = (np.zeros(16), np.zeros((52, 3)), np.full(3, 3.0))
    found = fit(*scanned(), model(), start)
    assert found.verdict == "pass"
    assert found.report["start"].startswith("cold")


def test_properties_a_missing_hand_is_unobserved() -> None:
    found = cold(0, lost=1.0)
    assert found.verdict == "unobserved"
    assert "left_hand" in found.reason
    assert "right_hand" not in found.reason
    assert errors_mm(found.vertices)["body"] < 0.8


def test_properties_half_a_hand_does_not_pass_as_a_whole() -> None:
    found = cold(1, lost=0.75)
    assert (found.verdict, found.reason) == ("unobserved", "hole(left_hand)")


def calibration(found: Fit, truth: np.ndarray) -> tuple[float, float]:
    """RMS error over RMS predicted error, of the body without hands and of the hands."""
    off = np.linalg.norm(found.vertices - truth, axis=1)
    hand = np.isin(part_of_vertex(model()), [k for k, p in enumerate(PARTS) if "hand" in p])
    body, hands = (
        float(np.sqrt(np.mean(off[own] ** 2) / np.mean(found.vertex_sd_m[own] ** 2)))
        for own in (~hand, hand)
    )
    return body, hands


def test_properties_predicted_sd_belongs_to_the_error() -> None:
    body, hands = calibration(cold(), surface().at(truth()).vertices)
    assert 0.6 < body < 1.6
    assert 0.6 < hands < 1.8


@pytest.mark.prove
@pytest.mark.parametrize("noise_m", [2e-4, 5e-4, 1e-3])
def test_properties_predictions_are_calibrated(noise_m: float) -> None:
    """Of hands too, which keep their own noise and are smoothed."""
    found, settings = [], BodyScanSettings(noise_m=noise_m)
    for k in range(12):
        true = surface().at(truth(k)).vertices
        scan = simulate_body_scan(model(), true, settings, rng=rng(f"calibration {k}"))
        one = fit(scan.points, scan.normals, model())
        if one.verdict != "fail":
            found.append(calibration(one, true))
    assert len(found) >= 10
    body, hands = np.median(found, axis=0)
    assert 0.8 < body < 1.25
    assert 0.8 < hands < 1.25


def test_properties_the_last_stage_believes_the_scans_own_noise() -> None:
    believed = [stage["noise_mm"] for stage in cold().report["stages"]]
    assert believed[-2] == 1.0
    assert believed[-1] == pytest.approx(1e3 * BodyScanSettings().noise_m, rel=0.15)


def test_properties_spoiled_hands_do_not_make_the_body_thin() -> None:
    """They are smoothed; the shape is that of the rest."""
    assert errors_mm(cold().vertices)["body"] < 0.45


def test_properties_normals_may_be_missing() -> None:
    found = fit(scanned()[0], None, model())
    assert errors_mm(found.vertices)["body"] < 1.0


def test_properties_keypoints_and_a_known_pose_are_taken() -> None:
    _, pose, _ = surface().unpack(truth())
    joints = surface().at(truth()).joints
    found = fit(*scanned(), model(), keypoints=(np.arange(52), joints), pose_prior=(pose, 0.1))
    assert found.verdict == "pass"
    assert errors_mm(found.vertices)["body"] < 0.8


def test_properties_same_input_same_output() -> None:
    again = fit(*scanned(), model())
    np.testing.assert_array_equal(again.vertices, cold().vertices)


def bad(name: str) -> tuple[Any, Any]:
    points, normals = scanned()
    floor = rng("floor").uniform(-1.2, 1.2, (40_000, 3)) * [1, 0, 1]
    floor[:, 1] = np.quantile(points[:, 1], 0.002)
    legs = points[:, 1] < np.median(points[:, 1])
    up = np.tile([0.0, 1.0, 0.0], (len(floor), 1))
    hand, s = hands.model().v_template, hands.surface()
    alone, outward, _ = simulate_scan(hand, s.faces, ScanSettings(points=8000), rng=rng("hand"))
    return {
        "no_points": (np.zeros((0, 3)), None),
        "no_points_nan": (np.full((500, 3), np.nan), None),
        "scale": (points * 1000, normals),
        "scale_cm": (points * 100, normals),
        "scale_inch": (points / 0.0254, normals),
        "scale_hand": (alone, outward),
        "flipped_normals": (points, -normals),
        "two_bodies": (np.concatenate([points, points + [1.1, 0, 0]]),
                       np.concatenate([normals, normals])),
        "background": (np.concatenate([points, floor]), np.concatenate([normals, up])),
        "cold_start_failed": (points[legs], normals[legs]),
    }[name]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "said"),
    [("no_points", "finite"), ("no_points_nan", "finite"), ("scale", "in mm"),
     ("scale_cm", "in cm"), ("scale_inch", "in inch"), ("scale_hand", "hand model"),
     ("flipped_normals", "-normals"), ("two_bodies", "one at a time"), ("background", "cut"),
     ("cold_start_failed", "y up")],
)  # fmt: skip
def test_edge_bad_scans_fail_with_their_reason(name: str, said: str) -> None:
    found = fit(*bad(name), model())
    assert found.verdict == "fail"
    assert name.startswith(found.reason)
    assert found.reason in REASONS
    assert said in found.report["message"]


def test_edge_some_nan_points_do_no_harm() -> None:
    points, normals = (a.copy() for a in scanned())
    points[::50] = np.nan
    found = fit(points, normals, model())
    assert found.verdict == "pass"
    assert found.report["points_dropped"] == len(points[::50])


def test_edge_few_points_are_no_pass() -> None:
    points, normals = scanned()
    found = fit(points[:300], normals[:300], model())
    assert found.verdict != "pass"


@pytest.mark.parametrize(
    "given", [{"hand": "left"}, {"preset": "paper"}, {"components": 6}, {"curved": 0.75}]
)
def test_edge_options_of_hands_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ShapeError, match="hand models"):
        fit(*scanned(), model(), **given)


@pytest.mark.parametrize("part", ["left_foot", "left_hand", "head"])
def test_edge_parts_of_bodies_are_refused(part: Any) -> None:
    with pytest.raises(ModelError, match="no whole body"):
        fit(*scanned(), separate(model("cc0-supr"), part).model)


def test_edge_knowledge_must_be_finite() -> None:
    pose = np.full((52, 3), np.nan)
    for given in ({"pose_prior": (pose, 0.1)}, {"keypoints": ([3], pose[:1])}):
        with pytest.raises(ShapeError, match="finite"):
            fit(*scanned(), model(), **given)  # type: ignore[arg-type]


def test_edge_wrong_starts() -> None:
    with pytest.raises(ShapeError, match="start="):
        fit(*scanned(), model(), "warm")
    with pytest.raises(ShapeError, match="start has shapes"):
        fit(*scanned(), model(), (np.zeros(16), np.zeros(3), np.zeros(3)))
    with pytest.raises(ShapeError, match="not finite"):
        fit(*scanned(), model(), (np.full(16, np.nan), np.zeros((52, 3)), np.zeros(3)))
    s = surface("cc0-supr")
    start = (np.ones(4), np.zeros((75, 3)), np.zeros(3), np.ones(5))
    x = start_vector(s, start)
    assert x is not None
    assert x[s.shape].sum() == 4
    assert x[s.expression].sum() == 5


def test_edge_a_model_without_shape_components() -> None:
    """The shape is the template's; there is no coefficient to judge."""
    shape, pose, translation = surface().unpack(truth())
    bare = replace(model(), shapedirs=model().shapedirs[:, :, :0], digest="bare",
                   v_template=model().shaped(shape)[0])  # fmt: skip
    if bare.joint_basis is not None:
        bare = replace(bare, joint_basis=model().shaped(shape)[1][None])
    found = fit(*scanned(), bare, (np.zeros(0), pose, translation))
    assert (found.verdict, found.shape.shape) == ("pass", (0,))
    assert errors_mm(found.vertices)["body"] < 0.8
    assert found.report["largest_beta"] == 0


def test_properties_coupled_meshes_are_alike_alone_and_tracked() -> None:
    """One rule for the noise that the coupled stage believes: the scan's own scatter."""
    begin, believed = surface().unpack(truth()), {}
    with pytest.MonkeyPatch.context() as patch:
        for place in ("body_fit", "tracking_body"):

            def spy(*given: Any, place: str = place, **named: Any) -> Any:
                believed[place] = len(given), named.get("noise_m")
                return couple(*given, **named)

            patch.setattr(f"synthgen.registration.{place}.couple", spy)
        fit(*scanned(), model(), begin, coupled=True)
        track([scanned()], model(), begin, shape=begin[0], coupled=True)
    assert believed == {"body_fit": (4, None), "tracking_body": (4, None)}
