"""What verify promises: no false alarm, observable defects caught, sound round trips (minutes).

Small corpora of three products: RGB-D (and RGB, without its depth) plain and full, and a simulated
scanner's scans at half resolution.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from synthgen.config import load_config
from synthgen.corpus import open_corpus
from synthgen.corpus.runner import generate
from synthgen.verify import verify
from synthgen.verify.faults import FAULTS
from synthgen.verify.roundtrip import RoundTrip, round_trip
from synthgen.verify.self_test import ALL_FAULTS, cell, false_alarms

CLEAN, TRIPS, SCANS, SPOILT = 200, 60, 8, 4
# What a product may lack: a column, or units of different designs.
HONEST = ("stored", "stores no", "a scan has no", "one design")
WORN = [name for name, fault in FAULTS.items() if "hand_full" in fault.absent]


def made(folder: Path, preset: str, *settings: str) -> Path:
    generate(load_config(preset, list(settings)), folder / "c", progress=False)
    return folder / "c"


@pytest.fixture(scope="module")
def depth_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(
        tmp_path_factory.mktemp("rgbd"), "hand_rgbd", f"samples={CLEAN}", "render.width=160",
        "render.height=160", "render.spp=2", "render.max_depth=2",
    )  # fmt: skip


@pytest.fixture(scope="module")
def scan_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(
        tmp_path_factory.mktemp("scan"), "hand_scan", f"samples={SCANS}", "scanner.level=half",
        "render.width=128", "render.height=128", "render.spp=1",
    )  # fmt: skip


@pytest.fixture(scope="module")
def full_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(
        tmp_path_factory.mktemp("full"), "hand_full", "samples=12", "render.width=160",
        "render.height=160", "render.spp=4", "render.denoise=none", "things.occluder=1",
        "wear.sleeve=1", "optics.distortion=0.1",
    )  # fmt: skip


def explained_failures(trip: RoundTrip) -> bool:
    """Whether every fail is the fitter's: the truth explains the points, and the reason says so."""
    fails = [t for t in trip.trips if t.verdict == "fail"]
    return all(t.figures["truth_explains"] > 0.97 and "truth" in t.reason for t in fails)


@pytest.mark.prove
def test_reference_no_false_alarm(depth_path: Path, scan_path: Path, full_path: Path) -> None:
    corpus = open_corpus(depth_path)
    assert false_alarms(corpus, "RGB", CLEAN) == []
    assert false_alarms(corpus, "RGB-D", CLEAN) == []
    assert false_alarms(corpus, "scan", SPOILT) == []
    assert false_alarms(open_corpus(scan_path), "scan", SCANS) == []
    assert verify(scan_path).ok
    assert verify(full_path).ok


@pytest.mark.prove
@pytest.mark.parametrize("name", sorted(set(ALL_FAULTS) - set(WORN)))
def test_properties_defects_are_caught(depth_path: Path, scan_path: Path, name: str) -> None:
    for product, path in (("RGB", depth_path), ("RGB-D", depth_path), ("scan", scan_path)):
        found = cell(open_corpus(path), name, ALL_FAULTS[name], product, SPOILT)
        assert found.ok, found
        assert found.of or any(word in found.reason for word in HONEST), found


@pytest.mark.prove
@pytest.mark.parametrize("name", WORN)
def test_properties_defects_of_things_are_caught(full_path: Path, name: str) -> None:
    for product in ("RGB", "RGB-D"):
        found = cell(open_corpus(full_path), name, FAULTS[name], product, SPOILT)
        assert (found.caught, found.of) == (SPOILT, SPOILT), found


@pytest.mark.prove
def test_properties_round_trip_of_depth(depth_path: Path) -> None:
    trip = round_trip(depth_path, "perturbed", TRIPS)
    assert trip.ok, [t.reason for t in trip.worst_first[:3]]
    assert explained_failures(trip)
    good = trip.counts.get("pass", 0) + trip.counts.get("unobserved", 0)
    assert good >= 0.85 * TRIPS, trip.counts


@pytest.mark.prove
def test_properties_round_trip_of_scans(scan_path: Path) -> None:
    trip = round_trip(scan_path, "perturbed")
    assert trip.ok, [t.reason for t in trip.worst_first[:3]]
    good = trip.counts.get("pass", 0) + trip.counts.get("unobserved", 0)
    assert good == SCANS, trip.counts
    assert {t.source for t in trip.trips} == {"scan"}
