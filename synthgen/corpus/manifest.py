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
from synthgen.corpus import atomic, shards
from synthgen.corpus.shards import Entry
from synthgen.errors import IntegrityError

MANIFEST, TABLE, CARD = "MANIFEST.json", "samples.parquet", "DATASET_CARD.md"


def engine(variant: str, denoise: str = "none") -> dict[str, Any]:
    """Return what decides the bytes besides the config: back end and library versions.

    The denoiser counts where one is asked for: ``oidn``, or ``auto``, which may find it missing.
    """
    from synthgen.render import backend

    chosen = backend.resolve(variant)
    library = backend.find_llvm() if chosen.startswith("llvm") else None
    return {
        "variant": chosen,
        "llvm": backend.llvm_version(str(library)) if library else None,
        "versions": {
            "synthgen": __version__,
            **backend.versions(denoiser=denoise != "none"),
        },
    }


def write_manifest(corpus: Path) -> None:
    """Scan the committed shards and write ``MANIFEST.json``, ``samples.parquet`` and the card."""
    made = json.loads((corpus / "engine.json").read_bytes())
    done = [(k, shards.read_sidecar(corpus, k)) for k in shards.done_shards(corpus)]
    rows = [row for k, sidecar in done for row in _rows(corpus, k, sidecar)]
    manifest = {
        "format": "synthgen/1",
        **made,
        "samples": sum(len(sidecar["samples"]) for _, sidecar in done),
        "views": len(rows),
        "shards": [_summary(k, sidecar) for k, sidecar in done],
        "plan_sha256": hashlib.sha256((corpus / "plan.jsonl").read_bytes()).hexdigest(),
    }
    atomic.replace(corpus / TABLE, _parquet(rows))
    atomic.replace(corpus / CARD, _card(manifest, rows).encode())
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
    for name, (offset, size) in sorted(sidecar["columns"]["meta"]["members"].items()):
        data = shards.read_member(corpus, "meta", shard, Entry(offset, size))
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


def _parquet(rows: list[dict[str, Any]]) -> bytes:
    names = sorted({name for row in rows for name in row})
    table = pa.table({name: [row.get(name) for row in rows] for name in names})
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


def _card(manifest: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    left = sum(row.get("hand") == "left" for row in rows)
    files = sorted({str(row["licence"]) for row in rows if row.get("licence")})
    others = f"\nPictures and panoramas of others are in it, used under: {'; '.join(files)}.\n"
    return f"""---
license: cc0-1.0
task_categories: [keypoint-detection, depth-estimation]
tags: [synthetic, hands]
---
# A corpus of synthetic hands

Made by synthgen {manifest["versions"]["synthgen"]}; {manifest["samples"]} samples,
{len(rows)} views, {left} of them left hands. Config hash `{manifest["config_hash"]}`, variant
`{manifest["variant"]}`. With the same config, seed and versions every byte comes out again.

Columns are tars of equal keys (`image`, `depth`, `labels`, `meta`, where asked `exr`). Units:
metres, radians. Camera: OpenCV axes, integer pixel centres. Pose: axis-angle, mean included;
left hands are not mirrored. Hand keypoints: OpenPose order. Depth PNG: z in 0.1 mm, 0 = none.

Hands of the `cc0-hand` model are CC0. Parameters and vertices of licensed models (MANO and
others) fall under those models' licences: fields `spec.scene.subjects` and `keypoints_3d_m`.
Shapes and poses are authored distributions, not measurements of people.
{others if files else ""}"""
