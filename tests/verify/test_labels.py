"""Verify passes a sound corpus and catches every known defect and damage."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from synthgen.cli.main import main
from synthgen.config import load_config
from synthgen.corpus import open_corpus
from synthgen.corpus.runner import generate
from synthgen.errors import CorpusError
from synthgen.verify import verify
from synthgen.verify.checks import _normal_error, check_depth, check_surface, chirality
from synthgen.verify.draft import Draft
from synthgen.verify.faults import FAULTS
from synthgen.verify.redraw import Redrawn
from synthgen.verify.report import Record, VerifyReport
from synthgen.verify.roundtrip import round_trip
from synthgen.verify.roundtrip_page import write_page
from synthgen.verify.self_test import PRODUCTS, cell, judged


@pytest.fixture(scope="module")
def corpus_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("verify") / "c"
    small = ["samples=4", "render.width=160", "render.height=160", "render.spp=4",
             "corpus.shard_size=2"]  # fmt: skip
    generate(load_config("hand_rgbd", small), out, progress=False)
    return out


def test_smoke_sound_corpus_passes(corpus_path: Path) -> None:
    report = verify(corpus_path)
    assert report.ok, report.failures[:3]
    assert report.views == 4
    assert len(report.worst) >= 15


RARE = {"objects left out of the ids", "masks through what covers them",
        "sleeve labelled as skin", "distortion forgotten", "list of objects forgotten"}  # fmt: skip
IN_LABELS = [name for name, fault in FAULTS.items() if fault.needs in ("meta", "image", "labels")]


@pytest.mark.parametrize("name", sorted(set(IN_LABELS) - RARE))
def test_properties_every_known_defect_is_caught_in_pictures(corpus_path: Path, name: str) -> None:
    found = cell(open_corpus(corpus_path), name, FAULTS[name], "RGB", 4)
    assert found.ok, found
    assert found.of >= 1


@pytest.mark.parametrize("name", [n for n, fault in FAULTS.items() if fault.needs == "depth"])
def test_properties_every_defect_of_depth_is_caught(corpus_path: Path, name: str) -> None:
    found = cell(open_corpus(corpus_path), name, FAULTS[name], "RGB-D", 1)
    assert found.ok, found
    assert "depth" in found.checks


@pytest.mark.parametrize("name", sorted(RARE))
def test_properties_what_the_corpus_lacks_is_said(corpus_path: Path, name: str) -> None:
    found = cell(open_corpus(corpus_path), name, FAULTS[name], "RGB", 1)
    assert found.ok
    assert "hand_full" in found.reason


def test_smoke_pictures_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A corpus without depth gets its label checks, and is told so."""
    out = tmp_path / "c"
    generate(
        load_config("hand_rgbd", ["samples=1", "render.width=160", "render.height=160",
                                  "render.spp=2", "corpus.columns=[image,labels,meta]"]),
        out, progress=False,
    )  # fmt: skip
    view = open_corpus(out)[0].views[0]
    assert view.columns == {"image", "labels", "meta"}
    with pytest.raises(CorpusError, match="no column depth"):
        _ = view.depth_z_m
    assert verify(out).lacking == {"depth": 1}
    assert main(["verify", str(out), "--start", "perturbed"]) == 0
    said = capsys.readouterr().out
    assert "1 views store no depth" in said
    assert "1 labels only" in said
    assert main(["verify", str(out), "--self-test", "--samples", "1"]) == 0
    said = capsys.readouterr().out
    assert "the corpus stores no depth" in said
    assert main(["preview", str(out)]) == 0
    assert main(["show", str(out), "--sample", "0"]) == 0


@pytest.fixture(scope="module")
def full_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that may hide a hand or bend the picture, in two rooms."""
    out = tmp_path_factory.mktemp("full") / "c"
    settings = [
        "samples=2", "seed=2", "render.width=128", "render.height=128", "render.spp=2",
        "render.denoise=none", "things.occluder=1", "wear.sleeve=1", "wear.ring=1",
        "background.room=1000", "optics.distortion=0.1",
    ]  # fmt: skip
    generate(load_config("hand_full", settings), out, progress=False)
    return out


def test_properties_full_passes_and_its_defects_are_caught(full_path: Path) -> None:
    corpus = open_corpus(full_path)
    report = verify(full_path)
    assert report.ok, report.failures[:3]
    kinds = [{o["kind"] for o in sample.views[0].objects if o["pixels"]} for sample in corpus]
    assert all("sleeve" in k and len(k) > 1 for k in kinds), kinds
    for name in IN_LABELS:
        found = cell(corpus, name, FAULTS[name], "RGB", 2)
        assert found.ok, found
        assert found.of >= 1, name


def test_reference_no_fault_is_not_caught(corpus_path: Path) -> None:
    corpus = open_corpus(corpus_path)
    for product in ("RGB", "RGB-D"):
        drafts = [Draft(corpus, k) for k in range(4)]
        assert judged(corpus, drafts, product, PRODUCTS[product]).raised == {}


def test_reference_chirality_of_a_plain_curled_hand() -> None:
    """Back to the camera, fingers up, curled away from it: a right hand has its thumb left."""
    p = np.zeros((21, 3))
    for finger, x in zip(range(1, 5), (-0.03, -0.01, 0.01, 0.03), strict=True):
        base = np.array([x, -0.09, 0.0])
        for k in range(4):
            p[4 * finger + 1 + k] = base + [0, -0.01 * k, 0.02 * k]
    p[1:5] = [[-0.03, -0.02, 0], [-0.04, -0.04, 0.01], [-0.045, -0.05, 0.02], [-0.05, -0.06, 0.03]]
    mirrored = p * [-1.0, 1.0, 1.0]
    assert chirality(p, "right") < 0 < chirality(p, "left")
    assert chirality(mirrored, "left") < 0 < chirality(mirrored, "right")


@pytest.fixture(scope="module")
def tiny_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures too small for some checks."""
    out = tmp_path_factory.mktemp("tiny") / "c"
    small = ["samples=2", "seed=76", "render.width=48", "render.height=48", "render.spp=1"]
    generate(load_config("hand_rgbd", small), out, progress=False)
    return out


def test_edge_what_cannot_be_judged_is_said(
    tiny_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = verify(tiny_path)
    assert report.ok
    assert report.never_judged == ["normals", "stale image"]
    assert report.to_json()["not_judged"]["normals"]["judged"] == 0
    assert main(["verify", str(tiny_path)]) == 0
    said = capsys.readouterr().out
    assert "ok, but nothing is known of normals, stale image" in said
    assert "not judged: normals, 2 of 2: fewer than 50 pixels lie on smooth surface" in said


def test_edge_a_defect_that_cannot_be_judged_is_no_miss(tiny_path: Path) -> None:
    corpus = open_corpus(tiny_path)
    name = "normals away from the camera"
    found = cell(corpus, name, FAULTS[name], "RGB", 2)
    assert found.ok and found.of == 0
    assert found.reason == "normals not judged: fewer than 50 pixels lie on smooth surface"
    # visibility is judged by exact rays, whatever the size of the picture
    name = "hidden keypoints called visible"
    found = cell(corpus, name, FAULTS[name], "RGB", 2)
    assert (found.caught, found.of) == (2, 2), found


def test_edge_too_few_points_are_no_error_of_the_fit(tiny_path: Path, tmp_path: Path) -> None:
    trip = round_trip(tiny_path, "gt")
    assert [(hand.verdict, hand.reason) for hand in trip.trips] == 2 * [("fail", "no_points")]
    assert trip.ok
    assert not any("v2v_mean_mm" in hand.figures for hand in trip.trips)
    write_page(tmp_path / "trip.html", trip, "tiny")
    page = (tmp_path / "trip.html").read_text()
    assert "as fitted<img" not in page
    assert "at least 200 are needed" in page


def test_reference_a_missed_defect_is_no_pass(
    corpus_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A check that judges and sees nothing is a miss, and no excuse."""
    monkeypatch.setattr("synthgen.verify.checks._normal_error", lambda *_: 0.0)
    name = "normals away from the camera"
    found = cell(open_corpus(corpus_path), name, FAULTS[name], "RGB", 2)
    assert not found.ok
    assert found.of == 2 and len(found.missed) == 2


def test_edge_nan_fails_a_measurement() -> None:
    report = VerifyReport()
    report.measure(0, 0, "x", float("nan"), 1.0, "not a number")
    assert not report.ok


def test_edge_flipped_byte_is_named(tmp_path: Path) -> None:
    out = tmp_path / "c"
    generate(load_config("fixtures", ["samples=1"]), out, progress=False)
    tar = out / "image" / "000000.tar"
    data = bytearray(tar.read_bytes())
    data[900] ^= 255
    tar.write_bytes(bytes(data))
    report = verify(out)
    assert any(f.check == "checksum" and "image/000000.tar" in f.message for f in report.failures)


def test_reference_normals_across_a_thin_tip_are_not_judged() -> None:
    """Background on both sides of a finger's tip has no normal; the median was not a number."""
    depth = np.zeros((40, 40))
    depth[5:25, 5:25], depth[30:36, 10:11] = 0.5, 0.5
    normals = np.broadcast_to([0.0, 0.0, -1.0], (40, 40, 3))
    K = np.array([[50.0, 0, 20], [0, 50, 20], [0, 0, 1]])
    view: Any = SimpleNamespace(camera=SimpleNamespace(K=K), normals=normals)
    assert _normal_error(view, depth, depth > 0) == pytest.approx(0.0, abs=1e-3)


def test_edge_a_view_without_a_hand_is_not_judged(corpus_path: Path) -> None:
    """Not of infinite error: nothing is known of its depth, faces and normals."""
    sample = open_corpus(corpus_path)[0]
    nothing = np.zeros((8, 8), np.int64)
    view: Any = SimpleNamespace(
        columns={"depth", "labels"}, camera=sample.views[0].camera, instance_id=nothing,
        part_id=nothing, face_id=nothing - 1, depth_z_m=np.zeros((8, 8)), valid=nothing > 0,
        sensor_depth_z_m=np.zeros((8, 8)), normals=np.zeros((8, 8, 3)), uv=np.zeros((8, 8, 2)),
    )  # fmt: skip
    again = Redrawn(nothing, nothing - 1, np.zeros((8, 8, 3)), np.zeros((8, 8)))
    report = VerifyReport()
    check_depth(Record(report, 0, 0), view, again)
    check_surface(Record(report, 0, 0), sample, view, again)
    assert report.ok
    assert not report.worst
    assert set(report.reasons()) == {"depth", "sensor depth", "face", "barycentrics", "uv",
                                     "parts", "normal length", "normals"}  # fmt: skip
