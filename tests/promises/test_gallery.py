"""The gallery as a browser draws it: each switch shows its layer."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from synthgen.config import load_config
from synthgen.corpus.gallery import write_gallery
from synthgen.corpus.runner import generate

pytestmark = pytest.mark.prove
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")


def drawn(page: Path, out: Path) -> NDArray[np.uint8]:
    assert BROWSER is not None
    subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync",
         f"--user-data-dir={out.parent / 'browser'}", "--window-size=900,1400",
         f"--screenshot={out}", page.as_uri()],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    return cv2.imread(str(out))


@pytest.mark.skipif(BROWSER is None, reason="needs Chromium (Debian package chromium)")
def test_properties_switches_show_their_layers(tmp_path: Path) -> None:
    generate(load_config("fixtures"), tmp_path / "c", progress=False)
    page = write_gallery(tmp_path / "c").read_text()
    assert "http" not in page.replace("http-equiv", ""), "the page must need no network"
    states = {
        "picture": page,
        "parts": page.replace('id="parts"', 'id="parts" checked'),
        "depth": page.replace('id="depth"', 'id="depth" checked'),
        "bare": page.replace('id="bones" checked', 'id="bones"'),
    }
    shots = {}
    for name, text in states.items():
        (tmp_path / f"{name}.html").write_text(text)
        shots[name] = drawn(tmp_path / f"{name}.html", tmp_path / f"{name}.png").astype(int)
    for first, second, share in (
        ("parts", "picture", 0.05),
        ("depth", "picture", 0.05),
        ("depth", "parts", 0.05),
        ("bare", "picture", 0.001),
    ):
        changed = np.abs(shots[first] - shots[second]).max(axis=-1) > 24
        assert changed.mean() > share, (first, second)
