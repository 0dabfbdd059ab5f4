"""The schema documents itself: meaning, unit and range of every key."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import ValidationError

from synthgen.config import Config, config_from_dict
from synthgen.config.explain import allowed, dotted_keys
from synthgen.errors import ConfigError

SCHEMA = Config.model_json_schema()


def leaf(path: str) -> dict[str, Any]:
    node: dict[str, Any] = SCHEMA
    for name in path.split("."):
        node = node["properties"][name]
        if "$ref" in node:
            node = SCHEMA["$defs"][node["$ref"].rsplit("/", 1)[-1]]
    return node


def numbers(node: dict[str, Any]) -> list[dict[str, Any]]:
    inner = node.get("anyOf", []) + node.get("prefixItems", [])
    own = [node] if node.get("type") in ("integer", "number") else []
    return own + [found for child in inner for found in numbers(child)]


def test_smoke_defaults() -> None:
    assert Config().render.width == 256


@pytest.mark.parametrize("path", dotted_keys(SCHEMA))
def test_properties_every_key_is_documented_and_bounded(path: str) -> None:
    node = leaf(path)
    assert len(node.get("description", "")) > 5
    assert allowed(path, SCHEMA)
    for number in numbers(node):
        assert "minimum" in number or "exclusiveMinimum" in number
        assert "maximum" in number


def test_properties_keys_used_from_outside() -> None:
    keys = set(dotted_keys(SCHEMA))
    fixed = {"seed", "samples", "model.name", "corpus.shard_size"}
    assert fixed | {f"render.{name}" for name in ("width", "height", "spp", "quality")} <= keys


def test_edge_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Config().render.width = 3  # type: ignore[misc]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"seed": True}, "seed = True"),
        ({"seed": "1"}, "seed = '1'"),
        ({"seed": -1}, "from 0 to"),
        ({"render": {"spp": 1.5}}, "a whole number from 1 to 4096"),
        ({"camera": {"fov_deg": [60, 20]}}, r"write \[20.0, 60.0\]"),
        ({"camera": {"fov_deg": [20]}}, "camera.fov_deg"),
        ({"light": {"constant": 0, "area": 0, "room": 0}}, "positive weight"),
        ({"corpus": {"columns": ["image"]}}, "labels, meta missing"),
        ({"corpus": {"columns": ["image", "image", "depth", "labels", "meta"]}}, "twice"),
        ({"subjects": {"count": 0}}, "or null"),
        ({"shape": {"sigma": 0}}, "above 0 up to 3"),
    ],
)
def test_edge_refused(content: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        config_from_dict(content)


def test_properties_columns_take_the_fixed_order() -> None:
    columns = ["exr", "meta", "labels", "depth", "image"]
    config = config_from_dict({"corpus": {"columns": columns}})
    assert config.corpus.columns == ("image", "depth", "labels", "meta", "exr")


def test_properties_weights_by_name() -> None:
    weights = Config().light.weights()
    given = {name: weight for name, weight in weights.items() if weight}
    assert given == {"constant": 0.2, "area": 0.5, "room": 0.3}
    assert set(weights) - set(given) == {"lamp", "sky", "hdri"}


def test_properties_json_round_trip() -> None:
    config = Config(seed=5)
    assert config_from_dict(json.loads(config.model_dump_json())) == config
