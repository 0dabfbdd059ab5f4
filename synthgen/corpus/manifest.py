"""What is derived from the shards: manifest, table and card; written whole, by replacement."""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from synthgen import __version__
from synthgen.config import Config
from synthgen.corpus import atomic, shards
from synthgen.corpus.checksums import CONFIG, SEAL, config_sha256, file_sha256, seal_of
from synthgen.corpus.shards import Entry
from synthgen.errors import IntegrityError
from synthgen.models import load_hand
from synthgen.models.cache import sha256_of
from synthgen.models.finding import find
from synthgen.scene.files import listing_digest

MANIFEST, TABLE, CARD = "MANIFEST.json", "samples.parquet", "DATASET_CARD.md"


def engine(config: Config) -> dict[str, Any]:
    """Return what decides the bytes besides the config: model, rig, back end, library versions.

    The model's digest is of what places its vertices, the SHA-256 of its whole file: fingertips,
    pose table and texture coordinates decide bytes, too. The rig's digest is there where a scanner
    or a depth camera is, and that of a folder of pictures where samples choose from one.

    The denoiser counts where one is asked for: ``oidn``, or ``auto``, which may find it missing.
    """
    from synthgen.render import backend

    chosen = backend.resolve(config.render.variant)
    library = backend.find_llvm() if chosen.startswith("llvm") else None
    return {
        "model_digest": load_hand(config.model.name, hand="right").digest,
        "model_sha256": sha256_of(find(config.model.name)),
        "variant": chosen,
        "llvm": backend.llvm_version(str(library)) if library else None,
        "versions": {
            "synthgen": __version__,
            **backend.versions(denoiser=config.render.denoise != "none"),
        },
        **rig_digests(config),
        **listing_digests(config),
    }


def listing_digests(config: Config) -> dict[str, str]:
    """Return the digests of the user's folders that samples choose from: files may come and go."""
    found = {}
    if config.light.hdri > 0:
        found["hdri_listing"] = listing_digest(str(config.files.hdri), "panorama")
    if config.background.photo > 0:
        found["images_listing"] = listing_digest(str(config.files.images), "image")
    return found


def rig_digests(config: Config) -> dict[str, str]:
    """Return the digests of the rigs that a config uses: their files may change, its words not.

    Raises
    ------
    ConfigError
        If there is no such rig, its file is wrong, or no calibration draw of its seed can be used.
    """
    found = {}
    if config.scanner.rig is not None:
        from synthgen.scanner import load_rig

        found["rig_digest"] = load_rig(config.scanner.rig, config.scanner.seed).digest
    if config.render.sensor_depth != "off":
        from synthgen.corpus.sensing import RIG
        from synthgen.scanner import load_rig

        found["depth_rig_digest"] = load_rig(RIG, config.scanner.seed).digest
    return found


def write_manifest(corpus: Path) -> None:
    """Scan the committed shards and write ``MANIFEST.json``, ``samples.parquet`` and the card."""
    made = json.loads((corpus / "engine.json").read_bytes())
    parts, tables = [], []
    for k in shards.done_shards(corpus):
        sidecar = shards.read_sidecar(corpus, k)
        parts.append(_summary(k, sidecar) | {"sidecar_sha256": shards.sidecar_sha256(corpus, k)})
        tables.append(pa.Table.from_pylist(_rows(corpus, k, sidecar)))
    table = _joined(tables)
    plan = corpus / "plan.jsonl"
    manifest = {
        "format": "synthgen/1",
        **made,
        "samples": sum(len(part["samples"]) for part in parts),
        "views": table.num_rows,
        "shards": parts,
        "config_sha256": config_sha256(corpus / CONFIG),
        "plan_bytes": plan.stat().st_size,
        "plan_sha256": file_sha256(plan),
    }
    files = {TABLE: _parquet(table), CARD: _card(manifest, table).encode()}
    for name, data in files.items():
        atomic.replace(corpus / name, data)
    manifest["files"] = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    manifest[SEAL] = seal_of(manifest)
    text = json.dumps(manifest, sort_keys=True, indent=1)
    atomic.replace(corpus / MANIFEST, text.encode())


def _summary(shard: int, sidecar: dict[str, Any]) -> dict[str, Any]:
    columns = sidecar["columns"]
    return {
        "shard": shard,
        "samples": sidecar["samples"],
        "redrawn": sidecar["redrawn"],
        "columns": {c: {k: f[k] for k in ("bytes", "sha256")} for c, f in columns.items()},
    }


def _rows(corpus: Path, shard: int, sidecar: dict[str, Any]) -> list[dict[str, Any]]:
    rows = []
    for name, place in sorted(sidecar["columns"]["meta"]["members"].items()):
        data = shards.read_member(corpus, "meta", shard, name, Entry(*place))
        try:
            meta = json.loads(data)
        except ValueError as error:
            raise IntegrityError(f"meta of {name} in shard {shard}: {error}") from None
        rows.append(_row(shard, meta))
    return rows


def _row(shard: int, meta: dict[str, Any]) -> dict[str, Any]:
    spec, hands = meta["spec"], meta["hands"]
    states = [s for hand in hands for s in hand["keypoints_state"]]
    return {
        "key": meta["key"],
        "sample": spec["index"],
        "view": meta["view"],
        "shard": shard,
        "attempt": spec["attempt"],
        "hands": len(hands),
        "hand_pixels": sum(hand["pixels"] for hand in hands),
        "visible_keypoints": sum(s == 2 for s in states),
        "occluded_keypoints": sum(s == 1 for s in states),
        **spec["factors"],
    }


def _joined(tables: list[pa.Table]) -> pa.Table:
    """Stack the shards' tables, columns by name; a column that one lacks is null there."""
    whole = pa.concat_tables(tables, promote_options="permissive") if tables else pa.table({})
    return whole.select(sorted(whole.column_names)).combine_chunks()


def _parquet(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


def _card(manifest: dict[str, Any], table: pa.Table) -> str:
    sides = table["hand"].to_pylist() if "hand" in table.column_names else []
    licences = table["licence"].to_pylist() if "licence" in table.column_names else []
    files = sorted({str(licence) for licence in licences if licence})
    others = f"\nPictures and panoramas of others are in it, used under: {'; '.join(files)}.\n"
    return f"""---
license: cc0-1.0
task_categories: [keypoint-detection, depth-estimation]
tags: [synthetic, hands]
---
# A corpus of synthetic hands

Made by synthgen {manifest["versions"]["synthgen"]}; {manifest["samples"]} samples,
{table.num_rows} views, {sides.count("left")} of them left hands.
Config hash `{manifest["config_hash"]}`, variant `{manifest["variant"]}`.
With the same config, seed and versions every byte comes out again.

Columns are tars of equal keys (`image`, `depth`, `labels`, `meta`, where asked `exr`, `scan`,
`stereo`). Units: metres, radians. Camera: OpenCV axes, integer pixel centres. Pose: axis-angle,
mean included; left hands are not mirrored. Hand keypoints: OpenPose order. Depth PNG: z in 0.1 mm,
0 = none.

Hands of the `cc0-hand` model are CC0. Parameters and vertices of licensed models (MANO and
others) fall under those models' licences: fields `spec.scene.subjects` and `keypoints_3d_m`.
Shapes and poses are authored distributions, not measurements of people.
{others if files else ""}"""
