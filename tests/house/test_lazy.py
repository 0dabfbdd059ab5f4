"""Importing synthgen is light, and only rendering brings in Mitsuba."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

HEAVY = {"mitsuba", "drjit", "torch", "kornia"}
ALSO_LAZY = {"scipy", "numba", "pyarrow", "sklearn", "cv2", "matplotlib", "igl", "pydantic"}


def loaded(code: str) -> set[str]:
    """Run code in a fresh interpreter and return the top-level modules loaded after it."""
    ask = f"{code}\nimport json, sys\nprint(json.dumps([m.split('.')[0] for m in sys.modules]))"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_smoke_import_is_light() -> None:
    found = loaded("import synthgen")
    assert "synthgen" in found
    assert not found & (HEAVY | ALSO_LAZY)


@pytest.mark.parametrize(
    "code",
    [
        "import synthgen; synthgen.models.load('cc0-hand')",
        "import synthgen; synthgen.open_corpus",
        "import synthgen; synthgen.config.load_config('hand_rgbd')",
        "from synthgen.sampling.draw import draw_sample",
        "import synthgen.cli.main",
    ],
)
def test_properties_no_heavy_library(code: str) -> None:
    assert not loaded(code) & HEAVY


def test_properties_command_line_starts_light() -> None:
    found = loaded("from synthgen.cli.main import main; main(['--version'])")
    assert not found & (
        HEAVY | {"scipy", "numba", "pyarrow", "sklearn", "cv2", "matplotlib", "igl"}
    )
