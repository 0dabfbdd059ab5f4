"""plan, generate, show, verify, preview on one tiny corpus, as a user types them."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import synthgen

TINY = ["--set", "render.spp=1", "--set", "render.width=32", "--set", "render.height=32"]


def synthgen_command(*words: str) -> tuple[int, dict[str, Any]]:
    """Run a verb with --json in a process of its own; its exit code and its one object."""
    command = [sys.executable, "-m", "synthgen", *words, "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.stdout.count("\n") == 1, done.stderr
    return done.returncode, json.loads(done.stdout)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("corpus") / "tiny"
    code, payload = synthgen_command("generate", "fixtures", "--out", str(out), *TINY)
    assert code == 0, payload
    assert payload["samples"] == 4
    return out


@pytest.fixture
def corpus(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "corpus")


def test_smoke_corpus_opens(made: Path) -> None:
    corpus = synthgen.open_corpus(made)
    assert len(corpus) == 4
    assert corpus[0].views[0].image.shape == (32, 32, 3)


def test_smoke_plan(tmp_path: Path) -> None:
    out = tmp_path / "plan"
    code, payload = synthgen_command("plan", "fixtures", "--out", str(out), "--samples", "2")
    assert code == 0
    assert payload["samples"] == 2
    assert len((out / "plan.jsonl").read_text().splitlines()) == 2
    command = [sys.executable, "-m", "synthgen", "plan", "fixtures", "--out", str(out)]
    said = subprocess.run([*command, "--samples", "3"], capture_output=True, text=True).stdout
    assert said == f"3 samples planned in {out / 'plan.jsonl'}\n"  # no bar where nobody looks


def test_reference_same_command_finds_nothing_to_do(corpus: Path) -> None:
    code, payload = synthgen_command("generate", "fixtures", "--out", str(corpus), *TINY)
    assert code == 0
    assert (payload["shards_made"], payload["shards_present"]) == (0, 2)


def test_edge_other_config_is_refused(corpus: Path) -> None:
    before = {p: p.read_bytes() for p in sorted(corpus.rglob("*")) if p.is_file()}
    code, payload = synthgen_command("generate", "fixtures", "--out", str(corpus))
    assert code == 2
    assert str(corpus) in payload["error"]
    assert {p: p.read_bytes() for p in sorted(corpus.rglob("*")) if p.is_file()} == before


def test_smoke_verify_and_report(corpus: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    code, payload = synthgen_command("verify", str(corpus), "--report", str(report))
    assert code == 0, payload["failures"]
    assert payload["ok"] is True
    assert json.loads(report.read_text())["samples"] == 4


@pytest.mark.parametrize("name", ["image/000000.tar", "plan.jsonl"])
def test_edge_verify_names_a_flipped_byte(corpus: Path, name: str) -> None:
    content = bytearray((corpus / name).read_bytes())
    content[700] ^= 1
    (corpus / name).write_bytes(content)
    done = subprocess.run(
        [sys.executable, "-m", "synthgen", "verify", str(corpus)], capture_output=True, text=True
    )
    assert done.returncode == 1
    assert name in done.stdout


def test_smoke_show_and_remake(corpus: Path) -> None:
    code, payload = synthgen_command("show", str(corpus), "--sample", "3", "--remake")
    assert code == 0
    assert payload["remake"] == {"same": True, "differing": []}
    (subject,) = payload["subjects"]
    truth = synthgen.open_corpus(corpus)[3].truth
    for key, values in (("pose", truth.pose), ("joints_m", truth.joints)):
        assert subject[key] == values.astype(float).round(5).tolist()


def test_edge_a_sample_that_is_rejected_now_is_not_the_same(
    corpus: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from synthgen.corpus import show

    rejected = ("scan: the scan is empty", [])
    monkeypatch.setattr(show, "with_sensors", lambda *_: lambda spec: rejected)
    again = show.describe(corpus, 0, remake=True)["remake"]
    assert again == {"same": False, "differing": [], "reason": rejected[0]}


def test_smoke_pictures_of_a_corpus_on_a_read_only_disk_go_elsewhere(
    corpus: Path, tmp_path: Path
) -> None:
    out = tmp_path / "pictures"
    before = sorted(corpus.rglob("*"))
    code, payload = synthgen_command("show", str(corpus), "--sample", "1", "--out", str(out))
    assert (code, payload["pictures"]) == (0, [str(out / "000000001_00.png")])
    assert (out / "000000001_00.png").stat().st_size > 1000
    assert sorted(corpus.rglob("*")) == before


def test_edge_show_out_of_range(corpus: Path) -> None:
    code, payload = synthgen_command("show", str(corpus), "--sample", "4")
    assert code == 2
    assert "holds samples 0 to 3" in payload["error"]


def test_smoke_preview(corpus: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    code, payload = synthgen_command("preview", str(corpus), "--out", str(page))
    assert (code, payload) == (0, {"gallery": str(page)})
    assert "<img" in page.read_text()
    sheet = tmp_path / "sheet.jpg"
    words = ("preview", str(corpus), "--out", str(page), "--sheet", str(sheet))
    assert synthgen_command(*words) == (0, {"gallery": str(page), "sheet": str(sheet)})
    assert synthgen_command(*words[:2], *words[4:]) == (0, {"sheet": str(sheet)})
    assert not (corpus / "gallery.html").exists()


@pytest.mark.parametrize("verb", ["verify", "preview"])
def test_edge_no_corpus(verb: str, tmp_path: Path) -> None:
    code, payload = synthgen_command(verb, str(tmp_path / "none"))
    assert code == 2
    assert "none" in payload["error"]
