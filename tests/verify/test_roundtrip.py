"""The round trip on a small corpus, its alarm, its page, and the table of faults."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pytest

from synthgen.cli.main import main
from synthgen.config import load_config
from synthgen.corpus import open_corpus
from synthgen.corpus.runner import generate
from synthgen.corpus.sample import Sample, View
from synthgen.errors import ShapeError
from synthgen.verify.faults import FAULTS
from synthgen.verify.roundtrip import RoundTrip, round_trip, sample_trips
from synthgen.verify.roundtrip_page import write_page
from synthgen.verify.self_test import Cell, SelfTest, _cell, not_observable, self_test
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
    write_page(tmp_path / "trip.html", trip, "a <corpus>")
    page = (tmp_path / "trip.html").read_text()
    assert page.count("<figure>") == 3
    assert "a &lt;corpus&gt;" in page


def broken(corpus_path: Path, name: str) -> Sample:
    clean = open_corpus(corpus_path)[0]
    views = tuple(View(copy.deepcopy(v.meta), v.stored_member) for v in clean.views)
    for view in views:
        FAULTS[name].change(view)
    return Sample(clean.index, views, type(clean.spec).from_json(views[0].meta["spec"]))


@pytest.mark.parametrize("name", ["mean pose dropped", "depth in millimetres",
                                  "turned about the origin"])  # fmt: skip
def test_properties_alarm_without_any_label_check(corpus_path: Path, name: str) -> None:
    """The points alone, fitted, contradict a wrong truth."""
    trips = sample_trips(broken(corpus_path, name), "gt")
    assert trips[0].verdict == "truth_mismatch"
    assert trips[0].reason


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
    cell = _cell(open_corpus(corpus_path), [0], name, FAULTS[name], "scan")
    assert cell.ok
    assert cell.check == "round trip"


def test_reference_label_of_the_next_sample(corpus_path: Path) -> None:
    name = "label of the next sample"
    for product in ("RGB", "RGB-D", "scan"):
        assert _cell(open_corpus(corpus_path), [0], name, FAULTS[name], product).ok, product


def test_properties_what_cannot_be_seen_is_said() -> None:
    assert "no depth" in not_observable(FAULTS["depth from the near plane"], "RGB")
    assert "no pictures" in not_observable(FAULTS["BGR picture"], "scan")
    assert not not_observable(FAULTS["mean pose dropped"], "scan")
    missed = Cell("x", "RGB", 0, 2, "", "")
    assert not SelfTest((missed,), 1, ()).ok
    assert not SelfTest((), 1, ("sample 0",)).ok


@pytest.mark.slow
def test_properties_every_observable_cell_is_caught(corpus_path: Path) -> None:
    found = self_test(corpus_path, 2)
    missed = [(c.fault, c.product) for c in found.cells if not c.ok]
    assert not missed
    assert not found.false_alarms
