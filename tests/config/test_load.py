"""Presets, extends, overrides, hash and the resolved form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from synthgen.config import Config, config_from_dict, config_hash, load_config, resolved_yaml
from synthgen.config.presets import list_presets
from synthgen.errors import ConfigError


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", sorted(list_presets()))
def test_smoke_presets_load_and_are_short(name: str) -> None:
    assert isinstance(load_config(name), Config)
    assert len(list_presets()[name].read_text().splitlines()) < 60


def test_reference_hand_rgbd_states_the_defaults() -> None:
    assert load_config("hand_rgbd") == Config()


def test_reference_extends_then_set(tmp_path: Path) -> None:
    write(tmp_path / "base.yaml", "extends: hand_rgbd\nrender: {spp: 64, width: 128}\n")
    path = write(tmp_path / "top.yaml", "extends: base.yaml\nrender: {width: 512}\n")
    config = load_config(path, ["render.height=32", "seed=7", "seed=8"])
    assert (config.render.spp, config.render.width, config.render.height) == (64, 512, 32)
    assert config.seed == 8
    assert config.camera == Config().camera


def test_reference_set_takes_yaml() -> None:
    config = load_config(
        "hand_rgbd",
        ["camera={views: 2, offset: 1e-2}", "camera.fov_deg=[30, 40]", "subjects.count=null"],
    )
    assert config.camera.views == 2
    assert config.camera.offset == 0.01
    assert config.camera.fov_deg == (30.0, 40.0)
    assert config.camera.fill == Config().camera.fill


def test_properties_resolved_form_reads_back_equal(tmp_path: Path) -> None:
    config = load_config("fixtures", ["seed=3", "model.name='null'", "shape.sigma=1e-3"])
    assert load_config(write(tmp_path / "r.yaml", resolved_yaml(config))) == config


numbers = st.fixed_dictionaries(
    {
        "seed": st.integers(0, 2**63 - 1),
        "model": st.fixed_dictionaries({"name": st.text(min_size=1, max_size=30)}),
        "shape": st.fixed_dictionaries({"sigma": st.floats(1e-9, 3)}),
        "skin": st.fixed_dictionaries(
            {"tones": st.tuples(st.floats(0, 1), st.floats(0, 1)).map(sorted)}
        ),
    }
)


@given(numbers)
def test_properties_any_config_survives_yaml(content: dict[str, Any]) -> None:
    from synthgen.config.reading import parse_yaml

    config = config_from_dict(content)
    read = parse_yaml(resolved_yaml(config), "text").content
    assert config_from_dict(read) == config
    assert config_hash(config_from_dict(read)) == config_hash(config)


def test_properties_hash_leaves_out_samples_only() -> None:
    base = config_hash(load_config("hand_rgbd"))
    assert config_hash(load_config("hand_rgbd", ["samples=99"])) == base
    others = ["seed=1", "render.spp=17", "corpus.shard_size=3", "skin.tones=[0, 0.5]"]
    assert len({base, *(config_hash(load_config("hand_rgbd", [o])) for o in others)}) == 5


def test_properties_hash_ignores_how_a_number_is_written() -> None:
    one, two = (load_config("hand_rgbd", [f"shape.sigma={text}"]) for text in ("2", "2.0"))
    assert config_hash(one) == config_hash(two)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "camera.fovv=3",
            r"--set camera.fovv=3: unknown key 'camera.fovv' - did you mean 'fov_deg'",
        ),
        ("spp=3", "did you mean 'render.spp'"),
        ("render.spp=0", "render.spp = 0; allowed is a whole number from 1 to 4096"),
        ("model.hands=rigt", "did you mean 'right'.*both, left, right"),
        ("render=3", "expected keys: width"),
        ("seed.x=1", "--set seed.x=1: seed = "),
        ("seed", "write key=value"),
        ("=3", "write key=value"),
        ("a..b=3", "write key=value"),
        ("a" + ".b" * 5000 + "=3", "write key=value"),
        ("render.spp=[1", "unreadable YAML"),
        ("render.spp=&a 3", "anchors"),
        ("shape.sigma=.nan", "shape.sigma = '.nan'"),
        ("shape.sigma=1e999", "too large"),
        ("seed=99999999999999999999999999999999999999", "seed"),
    ],
)
def test_edge_overrides(override: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        load_config("hand_rgbd", [override])


def test_edge_error_names_file_and_line(tmp_path: Path) -> None:
    path = write(tmp_path / "x.yaml", "extends: hand_rgbd\n\nrender:\n  spp: 0\n  widht: 3\n")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert f"{path}, line 4: render.spp = 0" in str(caught.value)
    assert f"{path}, line 5: unknown key 'render.widht' - did you mean 'width'" in str(caught.value)


def test_edge_circle(tmp_path: Path) -> None:
    write(tmp_path / "a.yaml", "extends: b.yaml\n")
    write(tmp_path / "b.yaml", "extends: a.yaml\n")
    with pytest.raises(ConfigError, match="circle"):
        load_config(tmp_path / "a.yaml")


def test_edge_long_chain(tmp_path: Path) -> None:
    for k in range(12):
        write(tmp_path / f"{k}.yaml", f"extends: {k + 1}.yaml\n")
    with pytest.raises(ConfigError, match="more than 8"):
        load_config(tmp_path / "0.yaml")


@pytest.mark.parametrize("text", ["- 1\n- 2\n", "hello\n", "extends: [a, b]\n", "3\n"])
def test_edge_not_a_mapping(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match=r"x\.yaml"):
        load_config(write(tmp_path / "x.yaml", text))


def test_edge_empty_file_is_the_defaults(tmp_path: Path) -> None:
    assert load_config(write(tmp_path / "x.yaml", "")) == Config()
