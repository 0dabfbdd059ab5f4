"""What stands beside the pictures is compared with them: boxes, counts, ids, names, the EXR."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from synthgen.config import load_config
from synthgen.corpus import Corpus, open_corpus
from synthgen.corpus.columns import DEPTH_STEP_M, _exr, depth_steps
from synthgen.corpus.runner import generate
from synthgen.sampling import stream
from synthgen.verify import verify
from synthgen.verify.draft import Draft, write_drafts
from synthgen.verify.facts import _check_linear, check_exr
from synthgen.verify.report import Record, VerifyReport

COLUMNS = ("image", "depth", "labels", "meta", "exr")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    """One hand in a sleeve, a watch on it, something before it."""
    out = tmp_path_factory.mktemp("facts") / "c"
    settings = ["samples=1", "seed=2", "render.width=96", "render.height=96", "render.spp=2",
                "render.denoise=none", "things.occluder=1", "wear.sleeve=1",
                f"corpus.columns=[{','.join(COLUMNS)}]"]  # fmt: skip
    generate(load_config("hand_full", settings), out, progress=False)
    return open_corpus(out)


def test_smoke_a_sound_corpus_passes(corpus: Corpus) -> None:
    report = verify(corpus.path)
    assert report.ok, report.failures
    assert {"meta", "objects", "box", "pixels", "barycentrics", "exr K", "exr ids", "exr depth",
            "exr picture", "exr channels"} <= set(report.worst)  # fmt: skip


def _spoilt(corpus: Corpus, change: Callable[[dict[str, Any]], Any]) -> set[str]:
    """Return the checks that fail once the meta of a view was changed."""
    draft = Draft(corpus, 0)
    change(draft.views[0].meta)
    with tempfile.TemporaryDirectory() as folder:
        write_drafts(corpus, [draft], COLUMNS, Path(folder) / "c")
        return {failure.check for failure in verify(Path(folder) / "c").failures}


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("box", lambda m: m["hands"][0].update(box_xyxy=None)),
        ("box", lambda m: m["hands"][0]["box_xyxy"].__setitem__(2, 95)),
        ("pixels", lambda m: m["hands"][0].update(pixels=2 * m["hands"][0]["pixels"])),
        ("meta", lambda m: m["hands"][0].update(instance_id=2)),
        ("meta", lambda m: m["hands"][0].update(fingertip_set="mano")),
        ("meta", lambda m: m.update(keypoint_names=m["keypoint_names"][::-1])),
        ("meta", lambda m: m.update(depth_step_m=1e-3)),
        ("objects", lambda m: m.update(objects=[])),
        ("objects", lambda m: m["objects"].append(m["objects"][0])),
        ("objects", lambda m: m["objects"][0].update(subject=1)),
        ("objects", lambda m: m["objects"][0].update(kind="ring")),
        ("box", lambda m: m["objects"][0].update(box_xyxy=[0, 0, 1, 1])),
        ("pixels", lambda m: m["objects"][0].update(pixels=-1)),
        ("keypoint frame", lambda m: m["hands"][0].update(keypoints_state=[9] * 21)),
        # what cannot be read is a finding, too, and not the end of the verification
        ("readable", lambda m: m["hands"][0].update(keypoints_state=[-1] * 21)),
        ("readable", lambda m: m.update(objects=[{}])),
        ("readable", lambda m: m.update(objects=[7])),
        ("readable", lambda m: m.update(K=[[1.0]])),
        ("readable", lambda m: m["hands"][0].update(box_xyxy=[1, 2])),
    ],
)  # fmt: skip
def test_properties_wrong_facts_are_found(
    corpus: Corpus, name: str, change: Callable[[dict[str, Any]], Any]
) -> None:
    assert name in _spoilt(corpus, change)


def _exr_findings(corpus: Corpus, monkeypatch: pytest.MonkeyPatch, **changes: Any) -> set[str]:
    from synthgen.corpus.columns import decode_exr

    def changed(data: bytes) -> dict[str, Any]:
        channels = decode_exr(data)
        return channels | {name: change(channels[name]) for name, change in changes.items()}

    monkeypatch.setattr("synthgen.verify.facts.decode_exr", changed)
    report = VerifyReport()
    check_exr(Record(report, 0, 0), corpus[0].views[0])
    return {failure.check for failure in report.failures}


def test_properties_wrong_exrs_are_found(corpus: Corpus, monkeypatch: pytest.MonkeyPatch) -> None:
    find = lambda **changes: _exr_findings(corpus, monkeypatch, **changes)  # noqa: E731
    assert find() == set()
    assert find(RGB=lambda a: a[..., ::-1]) == {"exr channels"}
    assert "exr picture" in find(RGB=lambda a: a[:, ::-1])
    assert find(Z=lambda a: 1000 * a) == {"exr depth"}
    assert find(Z=lambda a: np.where(a > 0, a + 2e-4, 0)) == {"exr depth"}
    assert find(part=lambda a: np.roll(a, 1, axis=1)) == {"exr ids"}
    assert find(instance=lambda a: 0 * a) == {"exr ids"}
    monkeypatch.setattr("synthgen.verify.facts.exr_header", lambda _: {"K": np.eye(3)})
    assert find() == {"exr K"}


def test_edge_noise_of_grey_scenes_is_no_hue() -> None:
    rng = stream(0, "corpus", 0, 0, "grey")
    radiance = rng.lognormal(size=(100, 100, 1)) * np.ones(3) + 1e-5 * rng.random((100, 100, 3))
    picture = 80 * radiance**0.4
    noise = rng.normal(0, 3, radiance.shape)
    report = VerifyReport()
    for sign in (-1, 1):
        _check_linear(Record(report, 0, 0), radiance, np.clip(picture + sign * noise, 0, 255))
    assert report.ok, report.failures
    assert 0 < abs(report.worst["exr channels"][0]) < 0.05
    red = radiance * [1.0, 0.5, 0.2] ** rng.random((100, 100, 1))
    _check_linear(Record(report, 0, 0), red[..., ::-1], np.clip(80 * red**0.4, 0, 255))
    assert {failure.check for failure in report.failures} == {"exr channels"}


def test_edge_walls_at_the_end_of_the_depth_column_are_no_defect() -> None:
    """A depth that rounds to the last step is stored."""
    z = np.linspace(6.5530, 6.5540, 512, dtype=np.float32)[None]
    ids, camera = np.zeros(z.shape, np.uint8), SimpleNamespace(K=np.eye(3))
    labels = SimpleNamespace(depth_z_m=z, part_id=ids, instance_id=ids)
    drawn: Any = SimpleNamespace(linear=np.ones((*z.shape, 3), np.float32), camera=camera,
                                 exposure=1.0, labels=labels)  # fmt: skip
    data, steps = _exr(drawn), depth_steps(z)
    assert 0 < (steps == 65535).sum() < (steps == 0).sum()
    view: Any = SimpleNamespace(columns={"depth"}, camera=camera, stored=lambda *_: data,
                                depth_z_m=steps * DEPTH_STEP_M)  # fmt: skip
    report = VerifyReport()
    check_exr(Record(report, 0, 0), view)
    assert report.ok, report.failures


def test_edge_pictures_without_contrast_or_hue_are_not_judged() -> None:
    flat = np.full((4, 4, 3), 7.0)
    report = VerifyReport()
    _check_linear(Record(report, 0, 0), flat, flat)
    grey = np.repeat(np.arange(16.0).reshape(4, 4, 1), 3, axis=2)
    _check_linear(Record(report, 0, 0), grey, grey)
    assert report.ok
    assert [(row.check, row.reason) for row in report.unjudged] == [
        ("exr picture", "the picture has no contrast"), ("exr channels", "the picture has no hue")
    ]  # fmt: skip


def test_edge_the_worst_value_stands_beside_its_own_limit() -> None:
    """Masks may differ by a share of their own outline: 4 of 5 pixels are worse than 1 of 8."""
    report = VerifyReport()
    for value, limit in ((4.0, 5.0), (1.0, 8.0)):
        report.measure(0, 0, "mask", value, limit, "")
    assert report.worst["mask"] == (4.0, 5.0)
    report.measure(0, 0, "mask", float("nan"), 3.0, "")
    report.measure(0, 0, "mask", 9.0, 3.0, "")
    assert np.isnan(report.worst["mask"][0])
