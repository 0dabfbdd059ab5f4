"""The promises, with the real renderer: same bytes for any worker count, and made again alone."""

from __future__ import annotations

import filecmp
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from synthgen.config import load_config
from synthgen.corpus.runner import generate
from synthgen.corpus.show import describe

SMALL = ["samples=4", "corpus.shard_size=2", "render.width=48", "render.height=48"]


def same(a: Path, b: Path) -> bool:
    files = sorted(p.relative_to(a) for p in a.rglob("*") if p.is_file())
    return files == sorted(p.relative_to(b) for p in b.rglob("*") if p.is_file()) and all(
        filecmp.cmp(a / f, b / f, shallow=False) for f in files
    )


def test_properties_one_worker_or_two(tmp_path: Path) -> None:
    config = load_config("fixtures", SMALL)
    generate(config, tmp_path / "one", workers=1, progress=False)
    generate(config, tmp_path / "two", workers=2, progress=False)
    assert same(tmp_path / "one", tmp_path / "two")
    remade = describe(tmp_path / "one", 3, remake=True)["remake"]
    assert remade == {"same": True, "differing": []}


@pytest.mark.prove
def test_properties_killed_and_resumed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "synthgen", "generate", "fixtures", "--workers", "2"]
    command += [word for item in [*SMALL[1:], "samples=16"] for word in ("--set", item)]
    subprocess.run([*command, "--out", str(tmp_path / "whole")], check=True)
    for wait in (4.0, 6.0, 8.0):
        child = subprocess.Popen([*command, "--out", str(tmp_path / "cut")], start_new_session=True)
        time.sleep(wait)
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
    subprocess.run([*command, "--out", str(tmp_path / "cut")], check=True)
    for path in (tmp_path / "cut").rglob(".*.tmp"):
        path.unlink()
    assert same(tmp_path / "whole", tmp_path / "cut")


@pytest.mark.prove
def test_properties_memory_is_flat() -> None:
    code = """
import resource
from synthgen.config import load_config
from synthgen.render.renderer import Renderer
from synthgen.sampling.draw import draw_sample
config = load_config("hand_rgbd", ["render.width=64", "render.height=64", "render.spp=2"])
renderer = Renderer("llvm_ad_rgb")
def resident():
    return int(open("/proc/self/statm").read().split()[1])
seen = []
for i in range(300):
    renderer.attempt(draw_sample(config, i))
    seen.append(resident())
print(max(seen[200:]) / max(seen[:100]))
"""
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(child.stdout) < 1.03


@pytest.mark.prove
def test_properties_scans_made_by_two_processes(tmp_path: Path) -> None:
    """Whole corpora of scans, byte by byte, whatever order a process puts its sets in."""
    command = [sys.executable, "-m", "synthgen", "generate", "hand_scan", "--samples", "1"]
    small = ["scanner.rig=mini", "scanner.level=half", "render.width=32", "render.height=32"]
    command += [word for item in small for word in ("--set", item)]
    for seed in ("1", "2"):
        made = [*command, "--out", str(tmp_path / seed)]
        subprocess.run(made, check=True, env=os.environ | {"PYTHONHASHSEED": seed})
    assert (tmp_path / "1" / "scan" / "000000.tar").stat().st_size > 10_000
    assert same(tmp_path / "1", tmp_path / "2")
