"""Rigs: what is shipped, what a seed freezes, what a wrong file is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from synthgen.config.reading import read_yaml
from synthgen.errors import ConfigError
from synthgen.geometry.cameras import project
from synthgen.scanner import list_rigs, load_rig
from synthgen.scanner.calibration import epipolar_rms_px
from synthgen.scanner.rig import only
from synthgen.scanner.scaling import scaled

MINI = list_rigs()["mini"].read_text(encoding="utf-8")
# What the papers give: pairs, colour cameras, projectors, pixels (None where they do not say).
PAPERS = {
    "hand5": (5, 5, 10, (1624, 1236), (2448, 2048)),
    "body22": (22, 22, 34, None, None),
    "head6": (6, 6, None, None, None),
    "foot10": (10, None, None, None, None),
}


@pytest.mark.parametrize("name", sorted(list_rigs()))
def test_smoke_shipped_rigs_load(name: str) -> None:
    rig = load_rig(name)
    idents = [u.ident for u in rig.units] + [p.ident for p in rig.projectors]
    assert len(set(idents)) == len(idents)
    assert [u.index for u in rig.units] == list(range(len(rig.units)))
    assert rig.own_choices
    for unit in rig.units:
        at, z = project(unit.nominal.left, np.zeros((1, 3)))
        assert z[0] > 0
        assert ((at > 0) & (at < [unit.nominal.left.width, unit.nominal.left.height])).all()


@pytest.mark.parametrize("name", PAPERS)
def test_reference_what_the_papers_say(name: str) -> None:
    rig, (pairs, colours, projectors, grey, colour) = load_rig(name), PAPERS[name]
    assert len(rig.units) == pairs
    if colours is not None:
        assert sum(u.nominal.colour is not None for u in rig.units) == colours
    if projectors is not None:
        assert len(rig.projectors) == projectors
    for unit in rig.units:
        if grey is not None:
            assert (unit.nominal.left.width, unit.nominal.left.height) == grey
        if colour is not None and unit.nominal.colour is not None:
            assert (unit.nominal.colour.width, unit.nominal.colour.height) == colour
    assert "units" in rig.own_choices


@pytest.mark.parametrize(("name", "point", "normal"), [
    ("head6", (0.0, 0.14, 0.0), (0, 1, 0)),  # the crown
    ("head6", (0.0, -0.05, 0.1), (0, 0, 1)),  # the lips
    ("foot10", (0.0, -0.09, 0.12), (0, 0, 1)),  # the tips of the toes
    ("foot10", (0.0, -0.1, 0.0), (0, -1, 0)),  # the sole
    ("foot10", (0.05, -0.06, -0.05), (1, 0, 0)),
])  # fmt: skip
def test_properties_pairs_see_squarely(name: str, point: Any, normal: Any) -> None:
    """Some pair looks at what the scanner is for at less than 60 degrees, with both cameras."""
    cosines = []
    for unit in load_rig(name).units:
        ways = [c.position - np.array(point) for c in (unit.nominal.left, unit.nominal.right)]
        cosines.append(min(float(way @ normal / np.linalg.norm(way)) for way in ways))
    assert max(cosines) > 0.5


def test_properties_a_seed_is_one_scanner() -> None:
    a, b, other = load_rig("mini", 3), load_rig("mini", 3), load_rig("mini", 4)
    assert a == b
    assert a.units[0].nominal == other.units[0].nominal
    assert a.units[0].true != other.units[0].true
    assert a.projectors[0].pattern.seed != other.projectors[0].pattern.seed
    shift = np.array(
        [load_rig("mini", s).units[0].true.left.position - a.units[0].nominal.left.position
         for s in range(60)]
    )  # fmt: skip
    assert shift.std() == pytest.approx(a.error.translation_m, rel=0.25)


def test_properties_draws_stay_within_the_epipolar_limit() -> None:
    for seed in range(12):
        rig = load_rig("hand5", seed)
        assert max(rig.epipolar_px) <= rig.error.epipolar_limit_px
    unit = rig.units[2]
    assert epipolar_rms_px(unit.nominal, unit.nominal, rig.volume_m) < 1e-9


def test_properties_half_resolution_sees_the_same() -> None:
    rig = load_rig("mini")
    half = scaled(rig, 0.5)
    point = np.array([[0.011, -0.007, 0.004]])
    big, _ = project(rig.units[0].true.left, point)
    small, _ = project(half.units[0].true.left, point)
    assert np.allclose((big + 0.5) / 2 - 0.5, small, atol=1e-9)
    assert [u.ident for u in only(rig, ["right"]).units] == ["right"]
    with pytest.raises(ConfigError, match="did you mean 'front'"):
        rig.unit("fornt")


FAULTS = {
    "unknown key": (lambda t: t.replace("baseline_m", "base_line_m"), "did you mean 'baseline_m'"),
    "unknown key of a unit": (lambda t: t.replace("elevation_deg: 10, distance_m: 0.6}\n  right",
                              "elevatoin_deg: 10, distance_m: 0.6}\n  right"),
                              "did you mean 'elevation_deg'"),
    "unit twice": (lambda t: t.replace("  right:", "  front:"), "given twice"),
    "ids overlap": (lambda t: t + "projectors:\n  front: {azimuth_deg: 0, elevation_deg: 0, "
                    "distance_m: 1}\n", r"mine\.yaml: .*ids must not overlap"),
    "missing": (lambda t: t.replace("  baseline_m: 0.12\n", ""),
                r"mine\.yaml.*: pair\.baseline_m is missing"),
    "range": (lambda t: t.replace("baseline_m: 0.12", "baseline_m: -1"), "above 0"),
    "no light": (lambda t: t.replace("[[0, 0.12, 0]]", "[]"), "has 0 projectors"),
    "fine dots": (lambda t: t.replace("dot_m: 0.0016", "dot_m: 0.00001"), "larger dots"),
    "no picture": (lambda t: t.replace("kind: speckle", "kind: image"), "`image` names a file"),
    "no draw": (lambda t: t + "error: {translation_m: 0.02}\n", "none of 200 calibration draws"),
    "empty": (lambda _: "", r"mine\.yaml: .* expected keys: summary"),
    "even window": (lambda t: t.replace("window_px: 11", "window_px: 12"), "a middle pixel"),
    "not YAML": (lambda _: "a: [", "unreadable YAML"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_edge_wrong_files(fault: str, tmp_path: Path) -> None:
    change: Callable[[str], str]
    change, words = FAULTS[fault]
    text = change(MINI)
    assert text != MINI
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=words) as error:
        load_rig(path)
    assert "Traceback" not in str(error.value)


def test_edge_unknown_rig() -> None:
    with pytest.raises(ConfigError, match="did you mean 'hand5'"):
        load_rig("hnd5")
    for seed in ("0", 1.5, -1):
        with pytest.raises(ConfigError, match=rf"scanner seed {seed!r}; use an integer"):
            load_rig("mini", seed)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="no rig file"):
        load_rig("nowhere/rig.yaml")


def test_properties_the_order_of_units_is_content(tmp_path: Path) -> None:
    """Calibration is drawn unit after unit: another order is another scanner."""
    source = list_rigs()["hand5"]
    content: dict[str, Any] = dict(read_yaml(source).content)
    turned = content | {"units": dict(reversed(content["units"].items()))}
    path = tmp_path / "turned.yaml"
    path.write_text(yaml.safe_dump(turned, sort_keys=False))
    assert load_rig(path).digest != load_rig("hand5").digest
