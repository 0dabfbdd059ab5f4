"""What quality full turns on, and that whatever is set stays."""

from __future__ import annotations

import pytest

from synthgen.config import load_config, resolved_yaml
from synthgen.config.quality import FULL
from synthgen.config.schema import Config
from synthgen.errors import ConfigError


def test_smoke_full_fills_what_is_open() -> None:
    full = load_config("hand_rgbd", ["render.quality=full"])
    assert full.wear.sleeve == FULL["wear"]["sleeve"]
    assert full.sensor.bayer
    assert load_config("hand_rgbd").wear.sleeve == 0
    assert not load_config("hand_rgbd").sensor.bayer


def test_properties_what_is_set_stays() -> None:
    config = load_config("hand_full", ["wear.sleeve=0", "render.max_depth=3", "light.sky=0"])
    assert (config.wear.sleeve, config.render.max_depth, config.light.sky) == (0, 3, 0)
    assert config.wear.ring == FULL["wear"]["ring"]


def test_properties_every_value_is_one_that_the_schema_takes() -> None:
    plain = Config.model_validate_json("{}").model_dump(mode="json")
    for section, values in FULL.items():
        assert set(values) <= set(plain[section]), section
        plain[section] |= {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
    import json

    assert Config.model_validate_json(json.dumps(plain)).optics.motion == FULL["optics"]["motion"]


def test_properties_what_is_said_of_full_is_so() -> None:
    """The schema's "In full ..." is what users read; it must be the value, and there for each."""
    said = {}
    for section, owner in Config.model_fields.items():
        for key, field in getattr(owner.annotation, "model_fields", {}).items():
            words = " ".join((field.description or "").split())
            if "In full" in words and section not in ("quality",):
                said[section, key] = words.rsplit("In full ", 1)[1].rstrip(".")

    def word(value: object) -> str:
        if isinstance(value, tuple):
            return f"[{', '.join(word(v) for v in value)}]"
        return f"{value:g}" if type(value) in (int, float) else str(value).replace("True", "true")

    filled = {(s, k): word(v) for s, values in FULL.items() for k, v in values.items()}
    assert said == filled


def test_properties_resolved_form_reads_back_equal(tmp_path) -> None:  # type: ignore[no-untyped-def]
    config = load_config("hand_full")
    path = tmp_path / "c.yaml"
    path.write_text(resolved_yaml(config))
    assert load_config(str(path)) == config


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("light.hdri=1", r"files\.hdri"),
        ("background.photo=1", r"files\.images"),
        ("files.images=/somewhere", r"files\.licence is empty"),
        ("wear.ring=2", "from 0 to 1"),
        ("optics.distortion=1", r"from 0 to 0\.2"),
        ("sensor.jpeg=[90,80]", "must not exceed"),
    ],
)
def test_edge_errors_teach(setting: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_config("hand_rgbd", [setting])
