"""What the scanner promises: its benchmark's targets, at sizes of a few CPU minutes."""

from __future__ import annotations

import statistics
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from synthgen.cli import bench

pytestmark = pytest.mark.prove
# Times are for benchmarks.
NOT_HERE = ("CPU s",)


@pytest.fixture(scope="module")
def parts() -> Any:
    """The benchmark's modules: pairs, hands, setting."""
    bench._load(bench.FOLDER / "scanner.py")
    return lambda name: import_module(f"benchmarks.scanner_parts.{name}")


def missed(rows: list[list[Any]]) -> list[list[Any]]:
    return [row for row in rows if row[-1] == "NO" and not any(w in row[0] for w in NOT_HERE)]


def test_reference_temporal_noise_meets_the_cramer_rao_bound(parts: Any, tmp_path: Path) -> None:
    rows = parts("pairs").noise(tmp_path)
    assert [row[0] for row in rows][-1].endswith("Cramer-Rao bound")
    assert not missed(rows)


def test_properties_no_convexity_bias_on_a_finger(parts: Any) -> None:
    found = [parts("pairs").sphere_error(0.009, seed)[1].mean() for seed in range(16)]
    assert abs(statistics.fmean(found)) <= 0.005


def test_properties_hand_without_added_errors(parts: Any, tmp_path: Path) -> None:
    rows = parts("hands").hand(tmp_path)
    assert len([row for row in rows if row[-1]]) >= 10
    assert not missed(rows)
    assert (tmp_path / "T7_fused_exact.png").stat().st_size > 10_000


@pytest.mark.parametrize("tone", [0.05, 0.95])
@pytest.mark.parametrize("panels", [5, 2])
def test_properties_green_rule(parts: Any, tone: float, panels: int) -> None:
    recall, lost = parts("hands").green_shares(parts("hands").green_scan(tone, panels))
    assert recall >= 0.99
    assert lost <= 0.01


def test_properties_same_seed_same_bytes(parts: Any) -> None:
    hands, setting = parts("hands"), parts("setting")
    solid, rig = setting.hand(1).solid, setting.rig(exact=False)
    one, two, other = (
        hands.scan(hands.ScanScene((solid,)), rig, rng=setting.keyed(key), level="half")
        for key in (0, 0, 1)
    )
    assert hands._same(one, two)
    assert not hands._same(one, other)


def test_reference_default_budget(parts: Any, tmp_path: Path) -> None:
    """Twenty scanners before a hand that moves, everything on: the manufacturer's figure."""
    budget = import_module("benchmarks.scanner_budget").run(["scanners"], tmp_path)
    assert len([row for row in budget["rows"] if row[-1]]) == 1
    assert not missed(budget["rows"])


def test_reference_modelled_scanners_are_as_good_as_full_ones(parts: Any) -> None:
    setting, hands = parts("setting"), parts("hands")
    scene = hands.ScanScene((setting.hand(1).solid,))

    def rms(seed: int, level: Any) -> float:
        rig = setting.rig(seed, exact=False)
        asked = setting.settings(rig, level, true_disparity=False)
        found = hands.scan(scene, rig, rng=setting.keyed(seed), level=level, settings=asked)
        return float(setting.fused_rms(found))

    for seed in (2, 8, 13):
        assert rms(seed, "full") == pytest.approx(rms(seed, "model"), rel=0.25)
