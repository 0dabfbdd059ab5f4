"""``synthgen plan``: decide everything that is random, render nothing."""

from __future__ import annotations

from synthgen.cli.options import ConfigName, Json, OutDir, Samples, Seed, Sets, configured
from synthgen.cli.output import Result


def plan(
    config: ConfigName,
    out: OutDir,
    samples: Samples = None,
    seed: Seed = None,
    sets: Sets = None,
    as_json: Json = False,
) -> Result:
    """Write the plan of a corpus: one fully resolved row per sample, nothing rendered."""
    from synthgen.config import config_hash
    from synthgen.corpus.plan import write_plan

    loaded = configured(config, sets, samples, seed)
    write_plan(loaded, out, progress=not as_json)
    payload = {"out": str(out), "samples": loaded.samples, "hash": config_hash(loaded)}
    return Result(payload, [f"{loaded.samples} samples planned in {out / 'plan.jsonl'}"])
