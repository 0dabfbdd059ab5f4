"""The round trip on a small corpus, its alarm, its page, and the table of faults."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synthgen.cli.main import main
from synthgen.cli.verify import _trip_lines
from synthgen.config import load_config
from synthgen.corpus import open_corpus
from synthgen.corpus.runner import generate
from synthgen.errors import ShapeError
from synthgen.verify import verify
from synthgen.verify.draft import Draft, write_drafts
from synthgen.verify.faults import FAULTS
from synthgen.verify.report import VerifyReport
from synthgen.verify.roundtrip import HandTrip, RoundTrip, round_trip
from synthgen.verify.roundtrip_page import write_page
from synthgen.verify.self_test import PRODUCTS, ROUND_TRIP, Cell, SelfTest, cell, self_test
from synthgen.verify.stored_points import stored_points


@pytest.fixture(scope="module")
def corpus_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("trip") / "c"
    small = ["samples=3", "render.width=192", "render.height=192", "render.spp=1",
             "corpus.shard_size=3", "camera.views=2", "background.room=0", "light.room=0",
             "light.area=0"]  # fmt: skip
    generate(load_config("hand_rgbd", small), out, progress=False)
    return out


@pytest.fixture(scope="module")
def trip(corpus_path: Path) -> RoundTrip:
    return round_trip(corpus_path, "perturbed")


def test_reference_points_lie_on_the_true_surface(corpus_path: Path) -> None:
    import igl

    sample = open_corpus(corpus_path)[0]
    stored = stored_points(sample, 0)
    assert stored.source == "depth"
    assert len(stored.points) > 1000
    truth = sample.subjects[0]
    squared = igl.point_mesh_squared_distance(
        stored.points, truth.vertices.astype(np.float64), np.asarray(truth.loaded.faces, np.int64)
    )[0]
    assert np.quantile(np.sqrt(squared), 0.95) < 6e-4
    towards = stored.viewpoints.mean(axis=0) - stored.points
    assert (np.sum(stored.normals * towards, axis=1) > 0).mean() > 0.7


def test_smoke_sound_corpus_raises_no_alarm(trip: RoundTrip) -> None:
    assert trip.ok
    assert sum(trip.counts.values()) == 3
    assert trip.counts.get("pass", 0) + trip.counts.get("unobserved", 0) >= 2
    for hand in trip.trips:
        if hand.verdict == "pass":
            assert hand.figures["v2v_seen_mean_mm"] < 0.6
        assert hand.figures["truth_explains"] > 0.95


def test_properties_worst_come_first(trip: RoundTrip) -> None:
    order = [hand.badness for hand in trip.worst_first]
    assert order == sorted(order, reverse=True)


def test_smoke_report_and_page(trip: RoundTrip, tmp_path: Path) -> None:
    row = json.loads(json.dumps(trip.to_json()))
    assert row["start"] == "perturbed"
    assert {"v2v_mean_mm", "joints_mean_mm", "coverage", "floor_mm"} <= set(row["hands"][0])
    labels = VerifyReport()
    labels.measure(3, 0, "mask", 9.0, 2.0, "pixels differ")
    labels.not_judged(3, 0, "normals", "too few pixels")
    write_page(tmp_path / "trip.html", trip, "a <corpus>", labels)
    page = (tmp_path / "trip.html").read_text()
    assert page.count("<figure>") == 3
    assert "a &lt;corpus&gt;" in page
    assert "sample 3, view 0: mask: pixels differ (9, at most 2)" in page
    assert "not judged: normals, 1 of 1: too few pixels" in page
    unsound = sum(hand.verdict != "pass" for hand in trip.trips)
    assert page.count("as it truly was<img") == unsound


def test_reference_the_truth_is_pictured_where_the_points_lie(
    trip: RoundTrip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Smooth, as it was drawn: off the model's flat triangles the truth would look wrong."""
    import igl

    drawn = []

    def noted(points: Any, vertices: Any, faces: Any, **_: Any) -> Any:
        drawn.append((points, vertices, faces))
        return np.zeros((8, 8, 3), np.uint8)

    monkeypatch.setattr("synthgen.verify.roundtrip_page.draw_overlay", noted)
    hand = replace(trip.trips[0], verdict="fail", reason="shown with its truth")
    write_page(tmp_path / "trip.html", RoundTrip("gt", [hand]), "smooth")
    (_, (points, smooth, faces)) = drawn
    assert hand.truth is not None and hand.fit is not None
    flat_faces = np.ascontiguousarray(hand.fit.model.faces, np.int64)
    off = np.sqrt(igl.point_mesh_squared_distance(points, smooth, faces)[0])
    flat = np.sqrt(igl.point_mesh_squared_distance(points, hand.truth, flat_faces)[0])
    assert np.quantile(off, 0.95) < 1.5e-4 < np.quantile(flat, 0.95)


def test_edge_a_fit_far_from_the_truth_is_pictured(trip: RoundTrip, tmp_path: Path) -> None:
    hand = trip.trips[0]
    assert hand.truth is not None
    lost = replace(hand, verdict="fail", reason="far", truth=hand.truth + [0, 0, 2.0])
    write_page(tmp_path / "trip.html", RoundTrip("gt", [lost]), "far")
    assert (tmp_path / "trip.html").read_text().count("<img") == 2


@pytest.mark.parametrize("name", ["mean pose dropped", "depth stored in millimetres",
                                  "turned about the origin"])  # fmt: skip
def test_properties_alarm_without_any_label_check(
    corpus_path: Path, tmp_path: Path, name: str
) -> None:
    """The points alone, fitted, contradict a wrong truth."""
    corpus = open_corpus(corpus_path)
    draft = Draft(corpus, 0)
    FAULTS[name].change(draft, Draft(corpus, 1))
    write_drafts(corpus, [draft], PRODUCTS["RGB-D"], tmp_path / "c")
    (trip,) = round_trip(tmp_path / "c", "gt").trips
    assert trip.verdict == "truth_mismatch"
    assert trip.reason


def test_smoke_gt_and_cold_on_the_command_line(
    corpus_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "r.json"
    code = main(["verify", str(corpus_path), "--start", "cold", "--samples", "1", "--report",
                 str(report)])  # fmt: skip
    assert code == 0, capsys.readouterr().out
    assert "round trip from cold" in capsys.readouterr().out
    assert json.loads(report.read_text())["round_trip"]["start"] == "cold"
    assert report.with_suffix(".html").is_file()


def test_edge_unknown_start(corpus_path: Path) -> None:
    with pytest.raises(ShapeError, match="warm"):
        round_trip(corpus_path, "warm")


@pytest.mark.parametrize("name", ["mean pose doubled", "scan mirrored", "scan in millimetres"])
def test_properties_faults_of_scans_are_caught(corpus_path: Path, name: str) -> None:
    found = cell(open_corpus(corpus_path), name, FAULTS[name], "scan", 1)
    assert found.ok
    assert ROUND_TRIP in found.checks


def test_reference_label_of_the_next_sample(corpus_path: Path) -> None:
    name = "label of the next sample"
    for product in PRODUCTS:
        found = cell(open_corpus(corpus_path), name, FAULTS[name], product, 1)
        assert (found.caught, found.of) == (1, 1), product


def test_properties_what_cannot_be_seen_is_said(corpus_path: Path) -> None:
    corpus = open_corpus(corpus_path)
    for name, product, why in (("depth from the near plane", "RGB", "no depth"),
                               ("BGR picture", "scan", "no pictures")):  # fmt: skip
        assert why in cell(corpus, name, FAULTS[name], product, 1).reason
    missed = Cell("x", "RGB", 0, 2)
    assert not SelfTest((missed,), 1, ()).ok
    assert not SelfTest((), 1, ("sample 0",)).ok


def test_smoke_the_table_on_the_command_line(
    corpus_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    few = {name: FAULTS[name] for name in ("BGR picture", "scan mirrored", "distortion forgotten")}
    monkeypatch.setattr("synthgen.verify.self_test.ALL_FAULTS", few)
    assert main(["verify", str(corpus_path), "--self-test", "--samples", "1"]) == 0
    said = capsys.readouterr().out
    assert "1/1 skin hue" in said
    assert "scan: a scan has no pictures: BGR picture" in said
    assert "0 false alarms on 3 clean samples" in said


def test_edge_a_subject_that_is_no_hand_is_named(corpus_path: Path, tmp_path: Path) -> None:
    """No crash: bodies are not verified yet."""
    corpus = open_corpus(corpus_path)
    draft = Draft(corpus, 0)
    for view in draft.views:
        view.meta["spec"]["scene"]["subjects"][0]["model"] = "cc0-body"
    write_drafts(corpus, [draft], PRODUCTS["RGB-D"], tmp_path / "c")
    (failure,) = verify(tmp_path / "c").failures
    assert failure.check == "readable"
    assert "cc0-body" in failure.message
    (trip,) = round_trip(tmp_path / "c", "gt").trips
    assert trip.verdict == "truth_mismatch"
    assert "cc0-body" in trip.reason


@pytest.mark.slow
def test_properties_every_observable_cell_is_caught(corpus_path: Path) -> None:
    found = self_test(corpus_path, 1)
    missed = [(c.fault, c.product) for c in found.cells if not c.ok]
    assert not missed
    assert not found.false_alarms


def test_edge_hands_that_are_not_listed_are_counted() -> None:
    trips = [HandTrip(k, k % 2, "fail", "not_converged", "depth") for k in range(25)]
    lines = _trip_lines(RoundTrip("gt", [*trips, HandTrip(99, 0, "pass", "", "depth")]))
    assert len(lines) == 22
    assert sum(line.startswith("sample ") for line in lines) == 20
    assert any(", hand 1: fail (not_converged)" in line for line in lines)
    assert lines[20] == "... and 5 more hands (--report FILE holds all)"
    assert lines[21].startswith("round trip from gt: 25 fail, 1 pass")
