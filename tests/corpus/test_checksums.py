"""A flipped bit in any of a corpus's files is found, and the file is named."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import fake
import pytest

from synthgen.config import load_config
from synthgen.corpus import open_corpus, shards
from synthgen.corpus.checksums import SEAL, damaged_files, file_sha256, seal_of
from synthgen.corpus.plan import write_plan
from synthgen.corpus.runner import generate
from synthgen.errors import IntegrityError

SETTINGS = ["corpus.shard_size=2", "render.width=16", "render.height=16"]
FILES = (
    "MANIFEST.json", "plan.jsonl", "engine.json", "config.resolved.yaml", "samples.parquet",
    "DATASET_CARD.md", "shards/000001.json", "labels/000001.tar",
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("corpus") / "c"
    config = load_config("fixtures", ["samples=4", *SETTINGS])
    generate(config, out, maker=fake.quick, progress=False)
    return out


@pytest.fixture
def corpus(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "c")


def complaints(path: Path) -> str:
    """What opening, rehashing and comparing say, in a line each."""
    try:
        found = open_corpus(path)
        for shard in found.shard_numbers:
            shards.check_hashes(path, shard, found.sidecar_sha256[shard])
    except IntegrityError as error:
        return str(error)
    return "\n".join(damaged_files(path, found.manifest))


def test_smoke_a_whole_corpus(made: Path) -> None:
    assert complaints(made) == ""


@pytest.mark.parametrize("name", FILES)
def test_properties_flipped_bits_are_found(corpus: Path, name: str) -> None:
    whole = (corpus / name).read_bytes()
    for share in range(0, 100, 7):
        for bit in (0, 5):
            damaged = bytearray(whole)
            damaged[len(whole) * share // 100] ^= 1 << bit
            (corpus / name).write_bytes(damaged)
            assert f"{corpus / name}" in complaints(corpus), (share, bit)
    (corpus / name).write_bytes(whole)
    assert complaints(corpus) == ""


@pytest.mark.parametrize("name", FILES[1:])
def test_edge_missing(corpus: Path, name: str) -> None:
    (corpus / name).unlink()
    assert f"{corpus / name}" in complaints(corpus)


def test_edge_a_table_that_is_none(corpus: Path) -> None:
    (corpus / "samples.parquet").write_bytes(b"PAR1 and so on PAR1")
    with pytest.raises(IntegrityError, match=r"samples\.parquet cannot be read.*writes it anew"):
        _ = open_corpus(corpus).table


def test_properties_a_longer_plan_is_no_damage(corpus: Path) -> None:
    write_plan(load_config("fixtures", ["samples=7", *SETTINGS]), corpus, progress=False)
    assert complaints(corpus) == ""


def test_edge_what_an_older_manifest_did_not_record(corpus: Path) -> None:
    manifest = json.loads((corpus / "MANIFEST.json").read_bytes())
    for key in (SEAL, "files", "plan_bytes", "config_sha256"):
        del manifest[key]
    for entry in manifest["shards"]:
        del entry["sidecar_sha256"]
    (corpus / "MANIFEST.json").write_text(json.dumps(manifest))
    assert complaints(corpus) == ""
    assert open_corpus(corpus)[3].index == 3


def test_properties_a_shard_in_the_making_is_told(corpus: Path) -> None:
    shards.drop_shard(corpus, 1)
    with pytest.raises(IntegrityError, match=r"000001\.json is missing.*generate again"):
        _ = open_corpus(corpus)[3]


def test_reference_digests(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"abcdef")
    (tmp_path / "g").write_bytes(b"abc")
    assert file_sha256(path, 3) == file_sha256(tmp_path / "g") != file_sha256(path)
    assert seal_of({"a": 1, SEAL: "x"}) == seal_of({"a": 1})
