"""Scans as a corpus modality, with the smallest rig."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any, get_args

import igl
import numpy as np
import pytest

from synthgen.cli.show import show
from synthgen.config import load_config
from synthgen.config.schema import ScannerEffect
from synthgen.corpus import open_corpus
from synthgen.corpus.gallery import write_gallery
from synthgen.corpus.runner import generate
from synthgen.corpus.scanning import Scanning
from synthgen.errors import ConfigError
from synthgen.sampling.draw import draw_sample
from synthgen.scanner import Effects, load_rig
from synthgen.scanner.hand import hand_solid
from synthgen.scanner.result import empty_scan
from synthgen.scanner.sensor import SENSOR_EFFECTS
from synthgen.verify import verify

SETTINGS = [
    "scanner.rig=mini", "render.width=32", "render.height=32", "render.spp=1",
    "corpus.shard_size=1",
]  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scans") / "corpus"
    config = load_config("hand_scan", [*SETTINGS, "samples=1"])
    generate(config, out, progress=False)
    return out


def test_reference_scan_lies_on_the_truth_of_the_sample(made: Path) -> None:
    sample = open_corpus(made)[0]
    scan = sample.scan
    assert scan is not None
    assert len(scan.vertices) > 500
    hand = hand_solid(sample.truth.description).solid
    distance, _, _ = igl.point_mesh_squared_distance(
        scan.vertices.astype(np.float64), hand.vertices, hand.faces
    )[:3]
    assert np.quantile(np.sqrt(distance), 0.9) < 0.001
    error = np.abs(scan.provenance["error_m"])
    assert np.sqrt(distance) == pytest.approx(error, abs=2e-6)
    model = sample.truth.loaded
    assert scan.provenance["face"].max() < len(model.surface.faces)


def test_properties_units_come_back_with_what_stereo_networks_want(made: Path) -> None:
    scan = open_corpus(made)[0].scan
    assert scan is not None
    assert [unit.ident for unit in scan.units] == ["front", "right"]
    for unit in scan.units:
        assert unit.left is not None and unit.right is not None
        assert unit.left.dtype == np.uint8 and unit.left.shape == unit.right.shape
        assert unit.true_disparity is not None
        error = unit.disparity - unit.true_disparity
        if np.isfinite(error).sum() > 100:
            assert np.nanmedian(np.abs(error)) < 0.5
        x, y, d = np.argwhere(np.isfinite(unit.disparity))[0][::-1].tolist() + [0.0]
        h = unit.Q @ np.array([x, y, d, 1.0])
        assert h[:3] / h[3] == pytest.approx(
            np.linalg.inv(unit.pair.camera.T)[:3, :3]
            @ (unit.pair.points(np.array(x), np.array(y), np.array(d)) - unit.pair.camera.position)
        )


def test_smoke_gallery_shows_the_scan(made: Path, tmp_path: Path) -> None:
    page = write_gallery(made, tmp_path / "gallery.html").read_text()
    for name in ("speckle", "disparity", "error", "scan"):
        assert f'alt="{name}"' in page


def test_properties_made_again_the_bytes_are_the_same(made: Path) -> None:
    shown = show(made, sample=0, remake=True)
    assert shown.code == 0
    assert shown.payload["remake"] == {"same": True, "differing": []}
    assert len(shown.payload["pictures"]) == 5
    assert shown.payload["scan"]["rms_m"] < 0.001


@pytest.mark.slow
def test_properties_another_scanner_is_told(made: Path, tmp_path: Path) -> None:
    """Remade with another scanner's seed, what it made differs, and nothing else."""
    copy = shutil.copytree(made, tmp_path / "corpus")
    text = (copy / "config.resolved.yaml").read_text()
    assert text.count("level: full\n  seed: 0") == 1
    (copy / "config.resolved.yaml").write_text(
        text.replace("level: full\n  seed: 0", "level: full\n  seed: 1")
    )
    shown = show(copy, sample=0, remake=True)
    assert shown.code == 1
    differing = shown.payload["remake"]["differing"]
    assert {name.split("/")[0] for name in differing} == {"scan", "stereo"}
    suffixes = {name.split("_00.")[1] for name in differing}
    assert suffixes >= {"scan.ply", "texture.jpg", "scan.json", "front.left.png", "right.true.npy"}


def test_properties_one_effect_less_or_a_moving_hand_all_else_equal(
    made: Path, tmp_path: Path
) -> None:
    plain = open_corpus(made)[0]
    for number, asked in enumerate(("scanner.without=[specular]", "scanner.speed_m_s=0.3")):
        config = load_config("hand_scan", [*SETTINGS, asked, "samples=1"])
        generate(config, tmp_path / str(number), progress=False)
        other = open_corpus(tmp_path / str(number))[0]
        np.testing.assert_array_equal(other.views[0].image, plain.views[0].image)
        assert plain.scan is not None and other.scan is not None
        one, two = plain.scan.units[0], other.scan.units[0]
        assert one.left is not None and two.left is not None
        assert (one.left != two.left).mean() > 0.01
        speed = np.linalg.norm(other.scan.report["velocity_m_s"])
        assert speed == pytest.approx(0.3 if "speed" in asked else 0.0)
        assert verify(tmp_path / str(number)).ok


def test_properties_effects_of_sensors_can_be_left_out_by_name() -> None:
    names = set(get_args(ScannerEffect))
    light = {f.name for f in dataclasses.fields(Effects)} - {"vertex_cache"}
    assert names == light | set(SENSOR_EFFECTS)
    for name in sorted(names):
        config = load_config("hand_scan", [*SETTINGS, f"scanner.without=[{name}]"])
        scanning = Scanning(config, lambda _: (None, []))
        left_out = name in light and not getattr(scanning._effects, name)
        assert left_out != (scanning._rig != load_rig("mini"))


def test_edge_light_and_matching_of_no_pictures() -> None:
    columns = "corpus.columns=[image,depth,labels,meta,scan]"
    for asked in ("scanner.without=[specular]", "scanner.preset=best"):
        with pytest.raises(ConfigError, match="no light and no matching"):
            load_config("hand_scan", ["scanner.level=model", columns, asked])
    with pytest.raises(ConfigError, match="named twice"):
        load_config("hand_scan", ["scanner.without=[bounce,bounce]"])
    with pytest.raises(ConfigError, match="shadows"):
        load_config("hand_scan", ["scanner.without=[shine]"])


def test_edge_an_empty_scan_is_a_rejection(monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config("hand_scan", SETTINGS)
    spec = draw_sample(config, 0)
    views: list[Any] = ["a view"]
    scanning = Scanning(config, lambda _: (None, views))
    nothing = empty_scan((), "full", "the scan is empty. unit front: black")
    monkeypatch.setattr(scanning, "scan", lambda _: (nothing, np.eye(4)))
    assert scanning.attempt(spec) == ("scan: the scan is empty. unit front: black", [])
    rejected = Scanning(config, lambda _: ("view 0: out of frame", []))
    assert rejected.attempt(spec) == ("view 0: out of frame", [])
    assert dataclasses.is_dataclass(nothing)


def test_edge_columns_and_rig_belong_together() -> None:
    with pytest.raises(ConfigError, match=r"scanner\.rig is null"):
        load_config("hand_rgbd", ["corpus.columns=[image,depth,labels,meta,scan]"])
    with pytest.raises(ConfigError, match="add scan"):
        load_config("hand_rgbd", ["scanner.rig=mini"])
    with pytest.raises(ConfigError, match="takes no pictures"):
        load_config("hand_scan", ["scanner.level=model"])
