"""``synthgen config``: the schema, and a configuration with everything filled in."""

from __future__ import annotations

import json

import typer

from synthgen.cli.options import ConfigName, Json, Sets, configured
from synthgen.cli.output import Result

app = typer.Typer(no_args_is_help=True, help="What may be set, and what a preset sets.")


@app.command("schema")
def schema(as_json: Json = False) -> Result:
    """Print every key with its meaning, unit and range, as JSON Schema."""
    from synthgen.config import Config

    content = Config.model_json_schema()
    return Result(content, [json.dumps(content, indent=2, ensure_ascii=False)])


@app.command("show")
def show(config: ConfigName, sets: Sets = None, as_json: Json = False) -> Result:
    """Print a configuration with everything filled in, and its hash."""
    from synthgen.config import config_hash, resolved_yaml

    loaded = configured(config, sets)
    payload = {"hash": config_hash(loaded), "config": loaded.model_dump(mode="json")}
    return Result(payload, [resolved_yaml(loaded).rstrip()])
