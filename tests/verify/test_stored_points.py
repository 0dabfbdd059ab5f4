"""What sensors get wrong together is told from what averages out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synthgen.config import load_config
from synthgen.corpus import open_corpus
from synthgen.corpus.runner import generate
from synthgen.sampling import stream
from synthgen.verify import verify
from synthgen.verify.against_truth import contradiction, truth_explained
from synthgen.verify.stored_points import shared_error, stored_points


def test_reference_shared_error_of_an_offset_and_of_noise() -> None:
    rng = stream(0, "corpus", 0, 0, "noise")
    points = rng.uniform(0, 0.1, (40_000, 3)) * [1, 1, 0]
    offset = np.full(len(points), 3e-4)
    noise = rng.normal(0, 3e-4, len(points))
    assert shared_error(points, offset) == pytest.approx(3e-4)
    assert shared_error(points, noise) < 3e-5
    assert shared_error(points[:0], noise[:0]) == 0.0


def test_smoke_what_is_fitted_is_what_the_sensor_says(tmp_path: Path) -> None:
    settings = ["samples=1", "render.sensor_depth=model", "render.width=96", "render.height=96"]
    generate(load_config("fixtures", settings), tmp_path / "c", progress=False)
    sample = open_corpus(tmp_path / "c")[0]
    stored = stored_points(sample, 0)
    assert stored.source == "sensor depth"
    assert 0 < stored.bias_m < 0.02
    assert not np.allclose(stored.points, stored.exact, atol=1e-5)
    assert truth_explained(sample.truth, stored)[0] > 0.97
    report = verify(tmp_path / "c")
    assert report.ok
    assert 0 < report.worst["sensor depth"][0] < 0.02


def test_edge_points_elsewhere_speak_against_the_truth(tmp_path: Path) -> None:
    settings = ["samples=1", "render.width=96", "render.height=96"]
    generate(load_config("fixtures", settings), tmp_path / "c", progress=False)
    sample = open_corpus(tmp_path / "c")[0]
    stored = stored_points(sample, 0)
    assert not contradiction(*truth_explained(sample.truth, stored))
    moved = replace(stored, points=stored.points + 0.5, exact=stored.exact + 0.5)
    assert truth_explained(sample.truth, moved) == (0.0, {})
    off = np.arange(len(stored.points)) % 2 == 0
    assert off.sum() > 200
    poor = replace(stored, exact=stored.exact + 0.003 * stored.normals * off[:, None])
    assert 0.4 < truth_explained(sample.truth, poor)[0] < 0.6
    assert not contradiction(*truth_explained(sample.truth, replace(poor, trusted=~off)))
    assert truth_explained(sample.truth, replace(poor, trusted=off))[0] < 0.1
    assert truth_explained(sample.truth, replace(poor, trusted=off & False)) == (1.0, {})
    assert truth_explained(sample.truth, replace(moved, trusted=off & False)) == (0.0, {})
    assert "only 0 %" in contradiction(0.0, {})
    assert "at the index" in contradiction(0.99, {"palm": 1.0, "index": 0.6})
