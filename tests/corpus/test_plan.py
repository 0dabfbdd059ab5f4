"""The plan: rows of any worker are the same, an interrupted one goes on, single rows are found."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from synthgen.config import Config, load_config
from synthgen.corpus import plan
from synthgen.corpus.plan import PART, PLAN, count_rows, read_plan, write_plan
from synthgen.errors import CorpusError
from synthgen.sampling.draw import draw_sample
from synthgen.sampling.spec import SampleSpec


def config(samples: int) -> Config:
    return load_config("fixtures", [f"samples={samples}"])


def test_smoke_rows_are_the_drawn_samples(tmp_path: Path) -> None:
    write_plan(config(5), tmp_path / "c", progress=False)
    assert count_rows(tmp_path / "c") == 5
    assert read_plan(tmp_path / "c") == [draw_sample(config(5), k) for k in range(5)]
    assert read_plan(tmp_path / "c", 3, 99) == [draw_sample(config(5), k) for k in (3, 4)]
    assert read_plan(tmp_path / "c", 5) == []


def test_properties_same_rows_with_two_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "WORTH_WORKERS", 1)
    monkeypatch.setattr(plan, "CHUNK", 2)
    write_plan(config(7), tmp_path / "one", progress=False)
    write_plan(config(7), tmp_path / "two", workers=2, progress=False)
    assert (tmp_path / "one" / PLAN).read_bytes() == (tmp_path / "two" / PLAN).read_bytes()


def test_properties_an_interrupted_plan_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows that were drawn are kept, a torn last one is drawn again, none is drawn twice."""
    drawn: list[int] = []

    def interrupted(given: Config, index: int) -> SampleSpec:
        drawn.append(index)
        if drawn.count(4) == 1 and index == 4:
            raise KeyboardInterrupt
        return draw_sample(given, index)

    monkeypatch.setattr(plan, "draw_sample", interrupted)
    out = tmp_path / "cut"
    with pytest.raises(KeyboardInterrupt):
        write_plan(config(6), out, progress=False)
    assert not (out / PLAN).exists()
    with open(out / PART, "ab") as part:
        part.write(b'{"index": 4, "torn')
    write_plan(config(6), out, progress=False)
    assert drawn == [0, 1, 2, 3, 4, 4, 5]
    write_plan(config(6), tmp_path / "whole", progress=False)
    assert (out / PLAN).read_bytes() == (tmp_path / "whole" / PLAN).read_bytes()
    assert not (out / PART).exists()


def test_properties_a_longer_plan_keeps_its_rows(tmp_path: Path) -> None:
    write_plan(config(3), tmp_path / "c", progress=False)
    before = (tmp_path / "c" / PLAN).read_bytes()
    write_plan(config(5), tmp_path / "c", progress=False)
    after = (tmp_path / "c" / PLAN).read_bytes()
    assert after.startswith(before)
    assert [json.loads(row)["index"] for row in after.splitlines()] == list(range(5))


def test_edge_rows_of_an_emptied_folder_are_not_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who removes what is visible leaves the hidden part file: its rows are another corpus's."""

    def interrupted(given: Config, index: int) -> SampleSpec:
        if index == 3:
            raise KeyboardInterrupt
        return draw_sample(given, index)

    monkeypatch.setattr(plan, "draw_sample", interrupted)
    out = tmp_path / "c"
    with pytest.raises(KeyboardInterrupt):
        write_plan(config(6), out, progress=False)
    for found in out.iterdir():
        if found.name != PART:
            shutil.rmtree(found) if found.is_dir() else found.unlink()
    monkeypatch.undo()
    other = load_config("fixtures", ["samples=4", "seed=9"])
    write_plan(other, out, progress=False)
    assert read_plan(out) == [draw_sample(other, k) for k in range(4)]


def test_edge_a_folder_of_something_else_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "letters.txt").write_text("dear")
    with pytest.raises(CorpusError, match="not empty and holds no corpus"):
        write_plan(config(1), tmp_path, progress=False)
    assert [p.name for p in tmp_path.iterdir()] == ["letters.txt"]


def test_edge_missing_and_damaged(tmp_path: Path) -> None:
    with pytest.raises(CorpusError, match="is missing"):
        read_plan(tmp_path)
    (tmp_path / PLAN).write_text('{"index": 0}\n')
    with pytest.raises(CorpusError, match="row 0 is damaged"):
        read_plan(tmp_path)


def test_edge_another_folder_of_pictures_is_refused(tmp_path: Path) -> None:
    """Rows and redraws choose among the files: with one more they would choose others."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), np.zeros((40, 40, 3), np.uint8))
    only = ["background.plain=0", "background.procedural=0", "background.room=0"]
    mine = [*only, "background.photo=1", f"files.images={folder}", "files.licence=CC0"]
    write_plan(load_config("fixtures", mine), tmp_path / "c", progress=False)
    longer = load_config("fixtures", [*mine, "samples=6"])
    write_plan(longer, tmp_path / "c", progress=False)
    cv2.imwrite(str(folder / "b.png"), np.ones((40, 40, 3), np.uint8))
    with pytest.raises(CorpusError, match=r"making \(images_listing was \w+, is"):
        write_plan(longer, tmp_path / "c", progress=False)
