"""The wheel works elsewhere: installed in another environment, used from another folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path
from typing import Any

import pytest

import synthgen

ROOT = Path(synthgen.__file__).parents[1]

pytestmark = pytest.mark.prove


def run(*command: str | Path, cwd: Path, **extra: str) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | extra
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", out, cwd=ROOT)
    return next(out.glob("*.whl"))


@pytest.fixture(scope="module")
def command(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``synthgen`` of a new environment that borrows this one's libraries but not its checkout."""
    home = tmp_path_factory.mktemp("elsewhere")
    venv.create(home / "env", with_pip=False)
    python = home / "env" / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index",
        wheel, cwd=home)  # fmt: skip
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    own = Path(run(python, "-c", ask, cwd=home).strip())
    borrowed = run(sys.executable, "-c", ask, cwd=home).strip()
    # A plain path line adds the folder without its .pth files, so no editable checkout slips in.
    (own / "borrowed.pth").write_text(f"{borrowed}\n")
    return home / "env" / "bin" / "synthgen"


def test_properties_wheel_holds_data_and_no_tests(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {
        "synthgen/_data/configs/hand_rgbd.yaml",
        "synthgen/_data/configs/fixtures.yaml",
        "synthgen/_data/scenes/README.md",
        "synthgen/_data/scenes/rigs/hand5.yaml",
        "synthgen/_data/scenes/noise/consumer.yaml",
        "synthgen/models/data/cc0-hand.npz",
        "synthgen/py.typed",
    } <= names
    assert not [n for n in names if n.startswith(("tests/", "benchmarks/")) or n.endswith(".pyc")]


def test_smoke_presets_come_from_the_wheel(command: Path, tmp_path: Path) -> None:
    shown: dict[str, Any] = json.loads(
        run(command, "config", "show", "hand_rgbd", "--json", cwd=tmp_path)
    )
    assert shown["config"]["model"]["name"] == "cc0-hand"
    ask = "import synthgen, synthgen.config as c; print(c.data_folder('configs'))"
    folder = Path(run(command.parent / "python", "-c", ask, cwd=tmp_path).strip())
    assert folder.is_relative_to(command.parents[1])


def test_smoke_the_default_job_runs_elsewhere(command: Path, tmp_path: Path) -> None:
    llvm = sorted(Path(sys.prefix).glob("lib/libLLVM*.so*"))
    extra = {"DRJIT_LIBLLVM_PATH": str(llvm[0])} if llvm else {}
    run(command, "generate", "hand_rgbd", "--out", "corpus", "--samples", "2", "--set",
        "render.width=64", "--set", "render.height=64", cwd=tmp_path, **extra)  # fmt: skip
    report = json.loads(run(command, "verify", "corpus", "--json", cwd=tmp_path, **extra))
    assert (report["ok"], report["samples"]) == (True, 2)
    run(command, "preview", "corpus", cwd=tmp_path)
    assert (tmp_path / "corpus" / "gallery.html").is_file()
