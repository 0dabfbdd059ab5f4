"""Making corpora: identical bytes, resumable, refusing what does not fit, whole or absent."""

from __future__ import annotations

import errno
import fcntl
import filecmp
import os
from multiprocessing import queues
from pathlib import Path

import fake
import pytest

from synthgen.cli.main import main
from synthgen.config import Config, load_config
from synthgen.corpus import Sample, atomic, open_corpus, shards
from synthgen.corpus.runner import Maker, generate
from synthgen.errors import CorpusError, IntegrityError, WorkLeft
from synthgen.verify import verify


def config(*overrides: str) -> Config:
    base = ["samples=7", "corpus.shard_size=3", "render.width=32", "render.height=24"]
    return load_config("fixtures", [*base, *overrides])


def make(out: Path, *overrides: str, maker: Maker = fake.quick, workers: int = 1) -> Path:
    generate(config(*overrides), out, maker=maker, workers=workers, progress=False)
    return out


def same(a: Path, b: Path) -> bool:
    files = sorted(p.relative_to(a) for p in a.rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(b) for p in b.rglob("*") if p.is_file())
    return all(filecmp.cmp(a / f, b / f, shallow=False) for f in files)


def read_everything(sample: Sample) -> None:
    for view in sample.views:
        for name in ("image", "depth_z_m", "part_id", "instance_id", "normals", "face_id", "uv"):
            getattr(view, name)


def test_smoke_folder(tmp_path: Path) -> None:
    out = make(tmp_path / "c")
    names = {p.name for p in out.iterdir()}
    assert {"MANIFEST.json", "plan.jsonl", "samples.parquet", "config.resolved.yaml", "image",
            "depth", "labels", "meta", "shards", "DATASET_CARD.md"} <= names  # fmt: skip
    corpus = open_corpus(out)
    assert len(corpus) == 7
    assert corpus[-1].index == 6
    assert corpus.table.num_rows == 7
    assert [s.index for s in corpus] == list(range(7))


def test_properties_same_bytes_with_two_workers(tmp_path: Path) -> None:
    one, two = make(tmp_path / "one"), make(tmp_path / "two", workers=2)
    assert same(one, two)


def test_properties_resumes_after_an_interrupt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, out = make(tmp_path / "whole"), tmp_path / "cut"
    commit, count = shards.ShardWriter.commit, 0

    def interrupted(*args: object, **kwargs: object) -> None:
        nonlocal count
        count += 1
        if count == 2:
            raise KeyboardInterrupt
        commit(*args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(shards.ShardWriter, "commit", interrupted)
    with pytest.raises(WorkLeft, match="same command"):
        make(out)
    assert shards.done_shards(out) == [0]
    with pytest.raises(CorpusError, match="not finished"):
        open_corpus(out)
    monkeypatch.undo()
    assert same(whole, make(out))


def test_properties_a_killed_worker_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SYNTHGEN_TEST_MARKER", str(tmp_path / "died"))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    out = make(tmp_path / "killed", maker=fake.suicidal, workers=2)
    assert (tmp_path / "died").exists()
    assert same(make(tmp_path / "calm"), out)


def test_edge_workers_that_always_die(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    with pytest.raises(CorpusError, match="died"):
        make(tmp_path / "dead", maker=fake.deadly, workers=2)


def test_edge_what_a_worker_says_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A message that is sent round to be read again may be late, and the run look done."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))

    def put(*_: object) -> None:
        raise AssertionError("the parent has nothing to say to itself")

    monkeypatch.setattr(queues.Queue, "put", put)
    with pytest.raises(CorpusError, match="nothing pleases"):
        make(tmp_path / "never", maker=fake.never, workers=2)


def test_properties_a_range_of_shards_leaves_the_others(tmp_path: Path) -> None:
    out = make(tmp_path / "c")
    generate(config("samples=12"), out, shards_range=(3, 9), maker=fake.quick, progress=False)
    assert shards.done_shards(out) == [0, 1, 2, 3]
    assert [s.index for s in open_corpus(out)] == [*range(7), 9, 10, 11]
    assert same(make(tmp_path / "whole", "samples=12"), make(out, "samples=12"))


def test_properties_counts_of_two_runs_in_one_folder_add_up(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What another run holds is neither made here nor there yet."""
    out, loaded = tmp_path / "c", config()
    (out / "claims").mkdir(parents=True)
    with open(out / "claims" / "000001", "w") as claim:
        fcntl.flock(claim, fcntl.LOCK_EX)
        first = generate(loaded, out, maker=fake.quick, progress=False)
    total = first.shards_made + 1
    assert (first.shards_present, first.shards_elsewhere) == (0, 1)
    assert len(open_corpus(out)) == first.samples < loaded.samples
    partial = verify(out)  # of a renderer that draws squares: its labels are wrong
    assert (partial.planned, partial.there) == (loaded.samples, first.samples)
    assert main(["verify", str(out)]) == 1
    assert (
        f"{first.samples} of {loaded.samples} planned samples are made" in capsys.readouterr().out
    )
    second = generate(loaded, out, maker=fake.quick, progress=False, workers=2)
    assert (second.shards_made, second.shards_present) == (1, total - 1)
    assert (second.shards_elsewhere, second.samples) == (0, loaded.samples)
    third = generate(loaded, out, maker=fake.quick, progress=False)
    assert (third.shards_made, third.shards_present) == (0, total)


def test_edge_a_range_beyond_the_corpus(tmp_path: Path) -> None:
    with pytest.raises(CorpusError, match=r"shards 3:9 holds none of the 3 shards 0:3"):
        generate(config(), tmp_path / "c", shards_range=(3, 9), maker=fake.quick, progress=False)


def test_properties_grows(tmp_path: Path) -> None:
    make(tmp_path / "grown", "samples=4")
    assert same(make(tmp_path / "whole"), make(tmp_path / "grown"))


def test_properties_rejected_samples_are_redrawn_and_recorded(tmp_path: Path) -> None:
    corpus = open_corpus(make(tmp_path / "picky", maker=fake.picky))
    assert [s.spec.attempt for s in corpus] == [0, 1, 0, 1, 0, 1, 0]
    redrawn = {k: v for entry in corpus.manifest["shards"] for k, v in entry["redrawn"].items()}
    assert redrawn == {"1": ["odd"], "3": ["odd"], "5": ["odd"]}


def test_edge_never_accepted(tmp_path: Path) -> None:
    with pytest.raises(CorpusError, match=r"rejected 10 times.*nothing pleases"):
        make(tmp_path / "never", maker=fake.never)


def test_edge_another_config_is_refused(tmp_path: Path) -> None:
    out = make(tmp_path / "c")
    with pytest.raises(CorpusError, match=r"another making \(seed was 0, is 5\); choose"):
        make(out, "seed=5")
    with pytest.raises(
        CorpusError, match=r"render\.height was 24, is 25; render\.spp was \d+, is 9"
    ):
        make(out, "render.height=25", "render.spp=9")
    (out / "config.resolved.yaml").write_text("no: configuration")
    with pytest.raises(CorpusError, match="config_hash was"):
        make(out, "seed=5")
    with pytest.raises(CorpusError, match="not empty"):
        make(tmp_path)


def test_edge_another_model_under_the_same_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model file that changed is refused on resume, and on recomputing vertices."""
    import numpy as np

    from synthgen.models.finding import DATA

    mine = tmp_path / "mine.npz"
    mine.write_bytes((DATA / "cc0-hand.npz").read_bytes())
    out = make(tmp_path / "c", f"model.name={mine}")
    assert open_corpus(out)[0].truth.vertices.shape == (1609, 3)
    with np.load(mine) as content:
        arrays = dict(content)
    np.savez(mine, **{**arrays, "v_template": arrays["v_template"] * np.float32(1.01)})
    with pytest.raises(CorpusError, match=r"model_digest was"):
        make(out, f"model.name={mine}", "samples=9")
    with pytest.raises(CorpusError, match="its vertices would be wrong"):
        _ = open_corpus(out)[0].truth.vertices
    tips = arrays["fingertip_ids"][[1, 0, 2, 3, 4]]  # keypoints move, vertices do not
    np.savez(mine, **{**arrays, "fingertip_ids": tips})
    with pytest.raises(CorpusError, match=r"making \(model_sha256 was"):
        make(out, f"model.name={mine}", "samples=9")


def test_edge_another_engine_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = make(tmp_path / "c")
    from synthgen.corpus import plan

    monkeypatch.setattr(plan, "engine", lambda config: {"variant": "cuda_ad_rgb", "llvm": None,
                                                   "versions": {}})  # fmt: skip
    with pytest.raises(CorpusError, match=r"variant was llvm_ad_rgb, is cuda_ad_rgb"):
        make(out)


def test_edge_full_disk_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, count = os.fsync, 0

    def full(handle: int) -> None:
        nonlocal count
        count += 1
        if count > 12:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(handle)

    monkeypatch.setattr(atomic.os, "fsync", full)
    out = tmp_path / "full"
    with pytest.raises(CorpusError, match=r"No space left.*same command"):
        make(out)
    monkeypatch.undo()
    assert not list(out.rglob("*.tmp"))
    assert same(make(tmp_path / "whole"), make(out))


def test_edge_unwritable_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(CorpusError, match="cannot create the folder"):
        make(tmp_path / "file" / "corpus")


@pytest.mark.parametrize("column", ["image", "labels", "meta"])
def test_edge_a_flipped_or_missing_byte_is_named(tmp_path: Path, column: str) -> None:
    out = make(tmp_path / "c")
    tar = out / column / "000001.tar"
    data = bytearray(tar.read_bytes())
    data[520] ^= 1  # within the first member
    tar.write_bytes(bytes(data))
    with pytest.raises(IntegrityError, match=rf"{column}/000001\.tar"):
        shards.check_hashes(out, 1)
    with pytest.raises(IntegrityError, match=rf"{column}/000001\.tar: the bytes of 000000003_00"):
        read_everything(open_corpus(out)[3])
    tar.write_bytes(bytes(data[:-512]))
    with pytest.raises(IntegrityError, match=rf"{column}/000001\.tar has"):
        open_corpus(out)
    tar.unlink()
    with pytest.raises(IntegrityError, match="missing"):
        open_corpus(out)


def test_edge_damaged_manifest_and_plan(tmp_path: Path) -> None:
    out = make(tmp_path / "c")
    (out / "MANIFEST.json").write_text("{")
    with pytest.raises(IntegrityError, match="MANIFEST"):
        open_corpus(out)
    (out / "plan.jsonl").write_text('{"index": 0}\n')
    from synthgen.corpus.plan import read_plan

    with pytest.raises(CorpusError, match="row 0 is damaged"):
        read_plan(out)


def test_properties_tars_are_plain(tmp_path: Path) -> None:
    import tarfile

    out = make(tmp_path / "c", "corpus.columns=[image,depth,labels,meta,exr]")
    keys = []
    for column in ("image", "depth", "labels", "meta", "exr"):
        with tarfile.open(out / column / "000000.tar") as archive:
            members = archive.getmembers()
            assert all(m.mtime == 0 and m.uid == 0 for m in members)
            keys.append(sorted({m.name.split(".")[0] for m in members}))
    assert all(k == keys[0] for k in keys)
    view = open_corpus(out)[0].views[0]
    assert view.linear is not None
    assert view.linear.shape == (24, 32, 3)
