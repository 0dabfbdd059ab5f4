"""Sentences about faults."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from synthgen.config.explain import allowed, dotted_keys, explain
from synthgen.config.schema import Config

SCHEMA = Config.model_json_schema()


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("seed", "a whole number from 0 to 9223372036854775807"),
        ("shape.sigma", "a number above 0 up to 3"),
        ("subjects.count", "a whole number from 1 to 1000000000 or null"),
        ("camera.fov_deg", "a list of 2, each a number from 5 to 120"),
        ("model.hands", "one of both, left, right"),
        ("render.quality", "one of plain, full"),
        ("model.name", "a text"),
        ("render", ""),
        ("nothing.here", ""),
    ],
)
def test_reference_allowed(path: str, words: str) -> None:
    assert allowed(path, SCHEMA) == words


def test_shape_dotted_keys() -> None:
    keys = dotted_keys(SCHEMA)
    assert "render.spp" in keys
    assert "render" not in keys
    assert len(keys) == len(set(keys))


def test_properties_all_faults_at_once() -> None:
    with pytest.raises(ValidationError) as caught:
        Config.model_validate_json('{"seed": -1, "render": {"spp": 0, "x": 1}}')
    text = explain(caught.value, Config, {"render": "file.yaml, line 2"})
    assert len(text.splitlines()) == 3
    assert "file.yaml, line 2: render.spp = 0" in text
    assert text.startswith("seed = -1; allowed is a whole number from 0 to ")


def test_edge_long_values_are_cut() -> None:
    with pytest.raises(ValidationError) as caught:
        Config.model_validate_json('{"seed": "%s"}' % ("x" * 500))
    assert len(explain(caught.value, Config, {})) < 250
