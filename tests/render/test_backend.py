"""The gate: chooses a usable LLVM and explains itself where there is none."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from synthgen.errors import BackendError
from synthgen.render import backend


def test_smoke_report_is_complete() -> None:
    found = backend.report()
    assert {"cuda", "llvm", "variant", "problem", "versions"} <= set(found)
    assert found["variant"] in ("llvm_ad_rgb", "cuda_ad_rgb")


def test_edge_unreadable_library(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake = tmp_path / "libLLVM-14.so"
    fake.write_bytes(b"no library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(fake))
    with pytest.raises(BackendError, match=r"unreadable.*pip install karellen-llvm-core"):
        backend.find_llvm()


def test_edge_old_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/old/libLLVM-14.so")
    monkeypatch.setattr(backend, "llvm_version", lambda path: "14.0.6")
    with pytest.raises(BackendError, match=r"LLVM 14\.0\.6.*>= 17"):
        backend.find_llvm()


def test_edge_none_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(backend, "_candidates", lambda: [])
    with pytest.raises(BackendError, match="no usable LLVM"):
        backend.resolve("llvm_ad_rgb")
    monkeypatch.setattr(backend, "cuda_works", lambda: False)
    assert "no usable LLVM" in str(backend.report()["problem"])


def test_properties_wheel_before_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    versions = {"wheel": "19.1.0", "system-22": "22.0.0", "system-15": "15.0.0"}
    order = [(1, "system-22"), (0, "wheel"), (1, "system-15")]
    monkeypatch.setattr(backend, "_candidates", lambda: order)
    monkeypatch.setattr(backend, "llvm_version", versions.get)
    assert backend.find_llvm() == Path("wheel")
    monkeypatch.setattr(backend, "_candidates", lambda: order[::2])
    assert backend.find_llvm() == Path("system-22")


def test_edge_import_order_is_an_error_not_an_abort() -> None:
    code = (
        "import os; os.environ.pop('DRJIT_LIBLLVM_PATH', None); import drjit\n"
        "from synthgen.render import backend\n"
        "try: backend.activate('llvm_ad_rgb')\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert child.returncode == 0
    assert child.stdout.startswith("BackendError drjit or mitsuba was imported before")


_WARNING = "\x1b[31m2026-01-01 00:00:00 WARN  main [Scene] slow\n\x1b[0m"


@pytest.mark.parametrize(
    "said", ["\nlit\n", f"{_WARNING}\nlit\n", f"\nlit\n{_WARNING}", "\ndark\n", ""]
)
def test_edge_the_probe_may_say_more_than_asked(monkeypatch: pytest.MonkeyPatch, said: str) -> None:
    """Mitsuba logs to stdout: a warning there must neither raise nor hide the GPU."""
    child = SimpleNamespace(returncode=0, stdout=said)
    monkeypatch.setattr(backend.ctypes.util, "find_library", lambda name: "libcuda.so.1")
    monkeypatch.setattr(backend.subprocess, "run", lambda *_, **__: child)
    backend.cuda_works.cache_clear()
    try:
        assert backend.cuda_works() is ("\nlit\n" in said)
    finally:
        backend.cuda_works.cache_clear()


def test_properties_aligned_copies_to_wide_addresses() -> None:
    for size in (1, 7, 64, 1001):
        values = np.arange(size, dtype=np.float64)[:, None] * [1.0, 2.0, 3.0]
        copy = backend.aligned(values)
        assert copy.ctypes.data % 128 == 0
        assert copy.dtype == np.float32
        np.testing.assert_array_equal(copy, values.astype(np.float32))
