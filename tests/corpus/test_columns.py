"""Encoding keeps labels to their stated steps."""

from __future__ import annotations

import json
from pathlib import Path

import fake
import numpy as np
import pytest

from synthgen.cli.main import main
from synthgen.config import load_config
from synthgen.corpus import open_corpus
from synthgen.corpus.columns import decode_image, png
from synthgen.corpus.gallery import contact_sheet, write_gallery
from synthgen.corpus.runner import generate
from synthgen.errors import CorpusError, IntegrityError
from synthgen.render.renderer import Renderer
from synthgen.sampling.draw import draw_sample


def real(config: object) -> object:
    return Renderer("llvm_ad_rgb").attempt


@pytest.fixture(scope="module")
def corpus_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("real") / "c"
    config = load_config("fixtures", ["samples=2", "render.width=80", "render.height=64"])
    generate(config, out, progress=False)
    return out


def test_reference_stored_labels_are_the_rendered_ones(corpus_path: Path) -> None:
    sample = open_corpus(corpus_path)[1]
    (fresh,) = Renderer("llvm_ad_rgb").render(sample.spec)
    view, labels = sample.views[0], fresh.labels
    assert np.abs(view.depth_z_m - labels.depth_z_m).max() <= 0.5e-4 + 1e-6
    assert np.abs(view.distance_m - labels.distance_m).max() <= 1e-4
    assert np.abs(view.normals - labels.normals).max() < 5e-5
    assert np.abs(view.uv - labels.uv).max() < 1e-5
    assert np.abs(view.barycentric - labels.barycentric).max() < 3e-5
    np.testing.assert_array_equal(view.part_id, labels.part_id)
    np.testing.assert_array_equal(view.face_id, labels.face_id)
    np.testing.assert_array_equal(view.keypoints_2d, fresh.hands[0].keypoints_2d)
    assert view.image.shape == (64, 80, 3)
    assert fresh.image is not None
    assert np.abs(view.image.astype(int) - fresh.image).mean() < 8  # JPEG, not BGR


def test_properties_truth_recomputes(corpus_path: Path) -> None:
    sample = open_corpus(corpus_path)[0]
    truth = sample.truth
    assert truth.vertices.shape == truth.loaded.v_template.shape
    assert truth.pose.shape == (16, 3)
    assert sample.subjects[0].joints.shape == (16, 3)
    assert sample.spec == draw_sample(
        load_config("fixtures", ["samples=2", "render.width=80", "render.height=64"]), 0
    )


def test_smoke_pictures_of_a_corpus_on_a_read_only_disk_go_elsewhere(
    corpus_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, out = sorted(corpus_path.rglob("*")), tmp_path / "pictures"
    assert main(["show", str(corpus_path), "--sample", "1", "--out", str(out), "--json"]) == 0
    (picture,) = json.loads(capsys.readouterr().out)["pictures"]
    assert picture == str(out / "000000001_00.png")
    assert Path(picture).stat().st_size > 1000
    assert sorted(corpus_path.rglob("*")) == before


def test_smoke_gallery_is_one_file(corpus_path: Path, tmp_path: Path) -> None:
    page = write_gallery(corpus_path, tmp_path / "g.html").read_text()
    assert "The same in all: attempt 0 &middot; " in page
    assert page.count('<div class="hist">') >= 3
    assert "<b>attempt</b>" not in page
    assert page.count("<figure>") == 2
    assert "http" not in page.replace("http-equiv", "")
    assert contact_sheet(corpus_path, tmp_path / "s.jpg", 2).stat().st_size > 1000


def test_edge_damaged_images() -> None:
    with pytest.raises(IntegrityError, match="this is damaged"):
        decode_image(b"no image", "this", 3)
    with pytest.raises(IntegrityError, match="damaged"):
        decode_image(png(np.zeros((4, 4), np.uint8)), "this", 3)


def test_edge_several_hands_have_no_only_one(corpus_path: Path) -> None:
    view = open_corpus(corpus_path)[0].views[0]
    view.meta["hands"] = view.meta["hands"] * 2
    with pytest.raises(CorpusError, match=r"view\.hands\[j\]"):
        _ = view.keypoints_2d


def test_shape_fake_is_what_the_renderer_gives() -> None:
    spec = draw_sample(load_config("fixtures"), 0)
    (view,) = fake.quick(load_config("fixtures"))(spec)[1]
    assert view.labels.part_id.shape == (spec.scene.cameras[0].height, spec.scene.cameras[0].width)
