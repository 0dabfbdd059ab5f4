"""A scan's own labels are compared with the true surface, and its colours with each other."""

from __future__ import annotations

from pathlib import Path

import pytest

from synthgen.config import load_config
from synthgen.corpus import Corpus, open_corpus
from synthgen.corpus.runner import generate
from synthgen.verify import verify
from synthgen.verify.draft import Draft, write_drafts
from synthgen.verify.faults import FAULTS
from synthgen.verify.self_test import cell
from synthgen.verify.stand_in import scanned

CHECKS = {"scan error", "scan error side", "scan faces", "scan barycentrics", "scan normals",
          "scan texture", "scan colours"}  # fmt: skip


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    """A hand that moves while it is scanned: errors are told for the scan's own time."""
    out = tmp_path_factory.mktemp("scans") / "c"
    small = ["samples=1", "scanner.rig=mini", "scanner.level=model", "scanner.speed_m_s=0.2",
             "render.width=64", "render.height=64", "render.spp=1", "skin.relief_m=1e-3",
             "corpus.columns=[image,depth,labels,meta,scan]"]  # fmt: skip
    generate(load_config("hand_scan", small), out, progress=False)
    return open_corpus(out)


def test_smoke_a_sound_scan_passes_and_is_judged(corpus: Corpus) -> None:
    report = verify(corpus.path)
    assert report.ok, report.failures
    assert set(report.worst) >= CHECKS
    assert report.worst["scan error"][0] < 1e-6


@pytest.mark.parametrize(
    ("fault", "check"),
    [
        ("scan mirrored", "scan error"),
        ("scan in millimetres", "scan error"),
        ("scan half a centimetre off", "scan error"),
        ("scan with inward normals", "scan normals"),
        ("errors of a scan in millimetres", "scan error"),
        ("errors of a scan with the other sign", "scan error side"),
        ("barycentrics of a scan of other corners", "scan barycentrics"),
        ("BGR colours of a scan", "scan colours"),
        ("texture of a scan upside down", "scan texture"),
    ],
)
def test_properties_wrong_labels_of_a_scan_are_found(
    corpus: Corpus, tmp_path: Path, fault: str, check: str
) -> None:
    draft = Draft(corpus, 0)
    FAULTS[fault].change(draft, draft)
    write_drafts(corpus, [draft], ("meta", "scan"), tmp_path / "c")
    found = {failure.check for failure in verify(tmp_path / "c").failures}
    assert check in found
    assert found <= CHECKS


def test_edge_a_stand_in_has_no_labels_of_its_own(corpus: Corpus, tmp_path: Path) -> None:
    draft = Draft(corpus, 0)
    draft.stored.pop("scan")
    draft.stand_in(scanned(draft.sample))
    write_drafts(corpus, [draft], ("meta", "scan"), tmp_path / "c")
    report = verify(tmp_path / "c")
    assert report.ok, report.failures
    assert {"scan error", "scan colours"} <= set(report.never_judged)
    name = "BGR colours of a scan"
    without = open_corpus(tmp_path / "c")
    assert "no scanner is simulated" in cell(without, name, FAULTS[name], "scan", 1).reason
