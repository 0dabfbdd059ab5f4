"""Rectified pairs: sound ones pass, and every known defect of them is caught."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synthgen.config import load_config
from synthgen.corpus import Corpus, open_corpus
from synthgen.corpus.runner import generate
from synthgen.sampling import stream
from synthgen.scanner import Rig, load_rig
from synthgen.verify import verify
from synthgen.verify.disparities import likeness, shift
from synthgen.verify.draft import Draft, write_drafts
from synthgen.verify.picture_place import offsets, placed, wavering
from synthgen.verify.self_test import ALL_FAULTS, cell
from synthgen.verify.stereo import rig_of
from synthgen.verify.stereo_faults import STEREO_FAULTS

COLUMNS = ("meta", "scan", "stereo")
# All units of a rig of one design have the same Q.
SAME = "Q of another unit"
GRIDS = {"stereo rows", "Q", "true disparity", "disparity grid", "disparity", "disparity offset",
         "stereo pictures", "stereo picture shift", "stereo picture place",
         "disparity place", "scan from pairs", "stereo cameras", "stereo units"}  # fmt: skip


# What views of 64 pixels are too small for.
PICTURES = {"normals", "stale image"}


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    out = tmp_path_factory.mktemp("stereo") / "c"
    small = ["samples=2", "scanner.rig=mini", "render.width=64", "render.height=64",
             "render.spp=1"]  # fmt: skip
    generate(load_config("hand_scan", small), out, progress=False)
    return open_corpus(out)


def raised(corpus: Corpus, draft: Draft, out: Path) -> set[str]:
    write_drafts(corpus, [draft], COLUMNS, out)
    return {failure.check for failure in verify(out).failures}


def test_smoke_sound_pairs_pass_and_all_is_judged(corpus: Corpus) -> None:
    report = verify(corpus.path)
    assert report.ok, report.failures[:3]
    assert GRIDS <= set(report.judged)
    assert report.judged["Q"] == 4  # two units of two samples


@pytest.mark.parametrize("name", sorted(set(STEREO_FAULTS) - {SAME}))
def test_properties_every_known_defect_is_caught(corpus: Corpus, name: str, tmp_path: Path) -> None:
    draft, following = Draft(corpus, 0), Draft(corpus, 1)
    assert not draft.changed
    STEREO_FAULTS[name].change(draft, following)
    assert draft.changed
    assert raised(corpus, draft, tmp_path / "c") & GRIDS


def test_properties_a_defect_is_named_with_its_unit(corpus: Corpus, tmp_path: Path) -> None:
    draft = Draft(corpus, 0)
    draft.units["right"].facts["Q"][0][3] += 0.5
    write_drafts(corpus, [draft], COLUMNS, tmp_path / "c")
    (failure,) = verify(tmp_path / "c").failures
    assert (failure.check, failure.view) == ("Q", -1)
    assert failure.message.startswith("unit right: ")


def test_properties_what_a_product_cannot_show_is_said(corpus: Corpus) -> None:
    same = cell(corpus, SAME, ALL_FAULTS[SAME], "scan", 1)
    assert same.ok and "one design" in same.reason
    pictures = cell(corpus, "pair swapped", ALL_FAULTS["pair swapped"], "RGB-D", 1)
    assert pictures.reason == "no rectified pairs are stored"


def test_edge_a_lost_unit_is_missed(corpus: Corpus, tmp_path: Path) -> None:
    draft = Draft(corpus, 0)
    draft.stored["stereo"] = {
        n: d for n, d in draft.stored["stereo"].items() if "_00.right." not in n
    }
    write_drafts(corpus, [draft], COLUMNS, tmp_path / "c")
    (failure,) = verify(tmp_path / "c").failures
    assert failure.check == "stereo units"
    assert "right" in failure.message


def test_edge_without_its_rig_a_pair_is_judged_by_the_rest(
    corpus: Corpus, monkeypatch: pytest.MonkeyPatch
) -> None:
    def edited(name: str, seed: int) -> Rig:
        return replace(load_rig(name, seed), digest="of a file that was edited since")

    monkeypatch.setattr("synthgen.verify.stereo.load_rig", edited)
    assert rig_of(corpus) == "the rig's file has changed since it scanned"
    report = verify(corpus.path, samples=1)
    assert report.ok
    assert set(report.never_judged) - PICTURES == {"stereo cameras", "true disparity"}
    assert report.judged["Q"] and report.judged["stereo pictures"]


def test_edge_a_unit_that_matched_nothing_is_not_judged(corpus: Corpus, tmp_path: Path) -> None:
    draft = Draft(corpus, 0)
    for unit in draft.units.values():
        unit["disparity"] = np.full_like(unit["disparity"], np.nan)
    write_drafts(corpus, [draft], COLUMNS, tmp_path / "c")
    report = verify(tmp_path / "c")
    assert report.ok
    assert report.reasons()["disparity"] == {"the unit matched too little": 2}


def test_reference_shift_of_a_curved_grid() -> None:
    rng = stream(0, "corpus", 0, 0, "slopes")
    slope = rng.normal(0, 0.4, (500, 2))
    off = 0.1 + slope @ [0.5, -0.25] + rng.normal(0, 0.02, 500)
    assert shift(off, slope) == pytest.approx([0.1, 0.5, -0.25], abs=0.01)


def test_reference_likeness_is_largest_at_the_disparity() -> None:
    rng = stream(0, "corpus", 0, 0, "speckle")
    wide = rng.integers(0, 255, (60, 90)).astype(np.uint8)
    left, right = wide[:, :80], wide[:, 4:84]  # x_right = x_left - 4
    grid = np.full((60, 80), 4.0, np.float32)
    scores = [likeness(left, right, grid, 1, turn) or 0 for turn in (-1.0, 0.0, 1.0)]
    assert scores[1] > 0.99
    assert max(scores[0], scores[2]) < 0.5
    assert likeness(left, right, np.full_like(grid, np.nan), 1, 0.0) is None


def speckled(move: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two pictures of a curved surface, both moved right and down, and its disparities."""
    y, x = np.indices((160, 200), np.float64)
    disparity = 12 + 6 * np.sin(x / 30) + 5 * np.cos(y / 25)
    waves = stream(0, "corpus", 0, 0, "waves").uniform(-0.6, 0.6, (60, 3))

    def seen(column: np.ndarray, row: np.ndarray) -> np.ndarray:
        light = sum(np.sin(a * column + b * row + 3 * c) for a, b, c in waves)
        return np.clip(128 + 10 * np.asarray(light), 0, 255)

    u, v = x - move[0], y - move[1]
    left = seen(u, v)
    right = np.empty_like(left)
    for k in range(len(right)):  # of a row, the point that the right camera sees at each pixel
        there = u[k] - (12 + 6 * np.sin(u[k] / 30) + 5 * np.cos(v[k, 0] / 25))
        point = np.interp(x[k] - move[0], there, u[k])
        right[k] = seen(point, v[k])
    return left.astype(np.uint8), right.astype(np.uint8), disparity[::2, ::2].astype(np.float32)


@pytest.mark.parametrize("move", [(0.0, 0.0), (0.5, 0.0), (-0.3, 0.4)])
def test_reference_pictures_that_are_moved_together(move: tuple[float, float]) -> None:
    left, right, disparity = speckled(move)
    assert placed(*offsets(left, right, disparity, 2)) == pytest.approx(move, abs=0.06)


def test_edge_what_matches_without_error_lies_in_its_place() -> None:
    slope = stream(0, "corpus", 0, 0, "slopes").standard_normal((500, 2))
    assert placed(np.zeros(500), slope) == pytest.approx((0, 0), abs=1e-9)


def test_properties_errors_that_whole_fingers_share_make_a_place_unsure() -> None:
    """As many errors of their own do not."""
    rng = stream(0, "corpus", 0, 0, "errors")
    slope = np.repeat(rng.normal(0, 0.1, (40, 2)), 200, axis=0)
    own, shared = rng.normal(0, 0.13, 8000), np.repeat(rng.normal(0, 0.13, 40), 200)
    assert (wavering(own, slope) < 0.05).all()
    assert (wavering(shared, slope) > 0.12).all()
    assert np.isfinite(placed(shared, slope)).all()  # whose own error knows only of neighbours


def test_edge_flat_or_dark_pictures_tell_no_place() -> None:
    left, right, disparity = speckled((0.5, 0.0))
    flat = np.full_like(disparity, 12.0)
    assert np.isnan(placed(*offsets(left, np.roll(left, -12, axis=1), flat, 2))).all()
    assert np.isnan(placed(*offsets(left // 200, right // 200, disparity, 2))).all()
