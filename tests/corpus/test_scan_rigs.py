"""A rig of the user's own decides bytes; refused calibrations and scans are told; resuming."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import fake
import numpy as np
import pytest

from synthgen.config import Config, load_config
from synthgen.corpus import open_corpus
from synthgen.corpus.runner import Attempt, generate
from synthgen.corpus.scanning import Scanning
from synthgen.corpus.show import describe
from synthgen.errors import ConfigError, CorpusError
from synthgen.scanner import list_rigs, load_rig

SMALL = [
    "render.width=32", "render.height=32", "render.spp=1", "corpus.shard_size=1",
    "corpus.columns=[image,depth,labels,meta,scan]",
]  # fmt: skip


def own_rig(folder: Path, name: str = "mine", old: str = "", new: str = "") -> Path:
    """A copy of the small rig with some words of its file replaced."""
    text = list_rigs()["mini"].read_text()
    assert old in text
    path = folder / f"{name}.yaml"
    path.write_text(text.replace(old, new) if old else text)
    return path


def digest(rig: Path | str) -> str:
    return load_rig(rig).digest


def make(out: Path, rig: Path | str, *sets: str, samples: int = 1, **options: Any) -> Path:
    config = load_config("hand_scan", [*SMALL, f"scanner.rig={rig}", f"samples={samples}", *sets])
    generate(config, out, progress=False, **options)
    return out


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("rigs")
    rig = own_rig(folder)
    return make(folder / "corpus", rig), rig


def test_smoke_what_every_unit_did_is_stored_and_shown(mine: tuple[Path, Path]) -> None:
    out, rig = mine
    corpus = open_corpus(out)
    report = corpus[0].scan.report
    assert report == json.loads(json.dumps(report))
    assert report["rig"] == rig.stem
    assert report["rig_digest"] == corpus.manifest["rig_digest"]
    for unit in report["units"].values():
        assert unit["problem"] is None or unit["matched"] == 0
        assert unit["lit"] >= unit["matched"] * 0.8
        assert unit["matched"] >= unit["kept"]
        assert unit["searched_px"][0] < unit["searched_px"][1]
    shown = describe(out, 0)["scan"]
    assert shown["units"] == report["units"]
    assert shown["notes"] == report["notes"]
    assert any("reaches beyond the working volume" in note for note in shown["notes"]), (
        "a hand is too large for the small rig"
    )


def test_properties_the_digest_is_of_the_content(mine: tuple[Path, Path], tmp_path: Path) -> None:
    _, rig = mine
    assert digest(rig) == digest("mini") == digest(own_rig(tmp_path, "other"))
    renamed = own_rig(tmp_path, "renamed", "Two small units", "A pair of units")
    assert digest(renamed) == digest(rig), "its summary decides nothing"
    brighter = own_rig(tmp_path, "brighter", "irradiance: 0.5", "irradiance: 1")
    assert digest(brighter) != digest(rig)


def test_properties_the_digest_is_of_the_slide_as_well(tmp_path: Path) -> None:
    rig = own_rig(tmp_path, "pictured", "kind: speckle", "kind: image, image: slide.png")
    picture = np.zeros((64, 64), np.uint8)
    picture[::7, ::5] = 255
    cv2.imwrite(str(tmp_path / "slide.png"), picture)
    before = digest(rig)
    cv2.imwrite(str(tmp_path / "slide.png"), 255 - picture)
    assert digest(rig) != before
    (tmp_path / "slide.png").unlink()
    with pytest.raises(ConfigError, match=r"slide\.png: cannot be read"):
        digest(rig)


def test_edge_a_rig_that_changed_is_refused(mine: tuple[Path, Path], tmp_path: Path) -> None:
    out, rig = mine
    copy = shutil.copytree(out, tmp_path / "corpus")
    before = rig.read_text()
    try:
        rig.write_text(before.replace("irradiance: 0.5", "irradiance: 0.6"))
        with pytest.raises(CorpusError, match=r"rig_digest was \w+, is"):
            make(copy, rig, samples=2)
        with pytest.raises(CorpusError, match=r"has changed since.*restore its file"):
            describe(copy, 0, remake=True)
    finally:
        rig.write_text(before)


def test_edge_a_calibration_that_cannot_be_matched(tmp_path: Path) -> None:
    """No sample is tried with a scanner of which no draw is good enough."""
    text = list_rigs()["mini"].read_text() + "error: {rotation_rad: 0.05}\n"
    rig = tmp_path / "poor.yaml"
    rig.write_text(text)
    with pytest.raises(ConfigError, match=r"none of 200 calibration draws"):
        make(tmp_path / "corpus", rig)
    assert not (tmp_path / "corpus").exists(), "nothing is planned either"


def test_edge_a_run_goes_on_and_records_the_rejection(tmp_path: Path) -> None:
    """The first hand is put before dark projectors, the redraw before bright ones."""
    dark, bright = own_rig(tmp_path, "dark", "irradiance: 0.5", "irradiance: 0"), "mini"

    def maker(config: Config) -> Attempt:
        inner = fake.quick(config)
        other = load_config("hand_scan", [*SMALL, f"scanner.rig={dark}"])
        failing, working = (Scanning(c, inner).attempt for c in (other, config))
        return lambda spec: (working if spec.attempt else failing)(spec)

    corpus = open_corpus(make(tmp_path / "corpus", bright, "scanner.level=half", maker=maker))
    assert corpus[0].spec.attempt == 1
    assert len(corpus[0].scan.vertices) > 100
    (reason,) = corpus.manifest["shards"][0]["redrawn"]["0"]
    assert reason.startswith("scan: the scan is empty")
    for unit in ("front", "right"):
        assert f"unit {unit}: black speckle: projectors front/0, right/0 give 0" in reason


def test_edge_a_scanner_that_never_measures(tmp_path: Path) -> None:
    def maker(config: Config) -> Attempt:
        return lambda spec: ("scan: the scan is empty", [])

    with pytest.raises(CorpusError, match=r"rejected 10 times.*`synthgen doctor rig mini`"):
        make(tmp_path / "corpus", "mini", maker=maker)


@pytest.mark.prove
def test_prove_killed_and_resumed_the_bytes_are_the_same(tmp_path: Path) -> None:
    whole = make(tmp_path / "whole", "mini", samples=3)
    sets = [f"--set={s}" for s in [*SMALL, "scanner.rig=mini"]]
    command = [sys.executable, "-m", "synthgen", "generate", "hand_scan", "--samples", "3",
               "--out", str(tmp_path / "killed"), *sets]  # fmt: skip
    process = subprocess.Popen(command, env=os.environ)
    deadline = time.monotonic() + 300
    while not (tmp_path / "killed" / "scan" / "000000.tar").exists():
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert len(list((tmp_path / "killed" / "scan").glob("*.tar"))) < 3
    subprocess.run(command, check=True, env=os.environ)
    for k in range(3):
        name = Path("scan") / f"{k:06d}.tar"
        assert (tmp_path / "killed" / name).read_bytes() == (whole / name).read_bytes()
