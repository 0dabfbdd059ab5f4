"""The gate to Mitsuba and Dr.Jit: picks LLVM or CUDA, and says what to do where neither works.

Dr.Jit with LLVM 14-16 aborts the process without a Python exception, so libraries are asked for
their version in a child process before Dr.Jit may see them.
"""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import BackendError

Variant = Literal["auto", "llvm_ad_rgb", "cuda_ad_rgb"]
OLDEST_LLVM = 17
# Bytes: the widest vector of any CPU that LLVM compiles for, twice.
_ALIGNMENT = 128
FIX = (
    f"Dr.Jit needs LLVM >= {OLDEST_LLVM} (older ones abort the process). "
    "Install it with `pip install karellen-llvm-core` (Linux x86-64), or a system package such as "
    "libllvm19, or set DRJIT_LIBLLVM_PATH to a libLLVM shared library"
)
# Objects of each kind that scenes of sixteen structures hold; a rectangle brings its material.
_RESERVED = ((320, "rectangle"), (640, "diffuse"), (64, "constant"))
# They live as long as the process, as Dr.Jit's tables do.
_PINNED: list[Any] = []
_ASK = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
numbers = [ctypes.c_uint() for _ in range(3)]
library.LLVMGetVersion(*map(ctypes.byref, numbers))
print(".".join(str(n.value) for n in numbers))
"""
_PROBE_CUDA = """
import drjit as dr, mitsuba as mi
mi.set_variant("cuda_ad_rgb")
scene = mi.load_dict(mi.cornell_box())
print("\\nlit" if float(dr.mean(mi.render(scene, spp=1).array)[0]) > 0 else "\\ndark")
"""


def activate(variant: str = "auto") -> str:
    """Make Mitsuba usable in this process, with one thread, and return the variant's name.

    Parameters
    ----------
    variant : {"auto", "llvm_ad_rgb", "cuda_ad_rgb"}
        ``auto`` takes CUDA where it works, else LLVM.

    Raises
    ------
    BackendError
        If no back end can work, or another variant is active in this process already.
    """
    if variant not in ("auto", "llvm_ad_rgb", "cuda_ad_rgb"):
        raise BackendError(f"variant {variant!r}; allowed: auto, llvm_ad_rgb, cuda_ad_rgb")
    active = _active()
    if active is not None:
        if variant not in ("auto", active):
            raise BackendError(
                f"variant {active} is active in this process, {variant} was asked for; "
                "one process renders with one variant: start a new one"
            )
        return active
    chosen = resolve(variant)
    if chosen == "llvm_ad_rgb":
        library = str(_require_llvm())
        if "drjit" in sys.modules and os.environ.get("DRJIT_LIBLLVM_PATH") != library:
            raise BackendError(
                "drjit or mitsuba was imported before synthgen chose its LLVM; import it after "
                f"synthgen.render.backend.activate(), or set DRJIT_LIBLLVM_PATH={library} first"
            )
        os.environ["DRJIT_LIBLLVM_PATH"] = library
    import drjit
    import mitsuba

    mitsuba.set_variant(chosen)
    drjit.set_thread_count(1)
    _reserve(mitsuba)
    return chosen


def _reserve(mi: ModuleType) -> None:
    """Widen Dr.Jit's tables of objects once, for all scenes that this process may load.

    Kernels hold the tables' width, so a scene that widened them made every scene before it compile
    again. The width is the highest number in use: the last object of each kind keeps it, the
    others leave their numbers to the scenes' own.
    """
    for count, kind in _RESERVED:
        held = [mi.load_dict({"type": kind}) for _ in range(count)]
        _PINNED.append(held[-1])


def resolve(variant: str = "auto") -> str:
    """Return the variant that :func:`activate` would use, without loading it here."""
    if variant == "llvm_ad_rgb":
        _require_llvm()
        return variant
    if cuda_works():
        return "cuda_ad_rgb"
    if variant == "cuda_ad_rgb":
        raise BackendError(
            "variant cuda_ad_rgb does not work on this machine (no NVIDIA driver, or its OptiX is "
            "missing); use render.variant=llvm_ad_rgb"
        )
    _require_llvm()
    return "llvm_ad_rgb"


def mitsuba() -> ModuleType:
    """Return the mitsuba module after :func:`activate`."""
    if _active() is None:
        raise BackendError("no variant is active; call synthgen.render.backend.activate() first")
    return sys.modules["mitsuba"]


def drjit() -> ModuleType:
    """Return the drjit module after :func:`activate`."""
    mitsuba()
    return sys.modules["drjit"]


def aligned(values: NDArray[Any]) -> NDArray[np.float32]:
    """Copy values to float32 memory that is aligned as Dr.Jit's own, same shape.

    Dr.Jit borrows NumPy's memory on the CPU and compiles another kernel for every mixture of
    aligned and unaligned inputs; where NumPy puts an array is chance, and so was the number of
    kernels.
    """
    count = int(np.prod(np.shape(values)))
    spare = np.empty(count + _ALIGNMENT // 4, dtype=np.float32)
    start = (-spare.ctypes.data // 4) % (_ALIGNMENT // 4)
    out = spare[start : start + count].reshape(np.shape(values))
    out[...] = values
    return out


def report() -> dict[str, Any]:
    """Return what the machine offers, in JSON types; never raises."""
    found: dict[str, Any] = {"cuda": False, "llvm": None, "variant": None, "problem": None}
    try:
        found["cuda"] = cuda_works()
        library = find_llvm()
        if library is not None:
            found["llvm"] = {"path": str(library), "version": llvm_version(str(library))}
        found["variant"] = resolve()
    except BackendError as error:
        found["problem"] = str(error)
    found["versions"] = versions()
    return found


def versions(*, denoiser: bool = False) -> dict[str, str]:
    """Return versions of the libraries that decide the bytes of a plan or a render."""
    names = ["mitsuba", "drjit", "numpy", "scipy", "opencv-python-headless"]
    names += ["scikit-learn", "libigl", "numba"]
    names += ["mitsuba-oidn"] if denoiser else []
    found = {}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "missing"
    return found


def find_llvm() -> Path | None:
    """Return a usable libLLVM: the user's, the wheel's, then the newest of the system's.

    Raises
    ------
    BackendError
        If ``DRJIT_LIBLLVM_PATH`` names a library that is unreadable or too old.
    """
    given = os.environ.get("DRJIT_LIBLLVM_PATH")
    if given:
        version = llvm_version(given)
        if version is None or _major(version) < OLDEST_LLVM:
            raise BackendError(
                f"DRJIT_LIBLLVM_PATH={given} is {f'LLVM {version}' if version else 'unreadable'}; "
                + FIX
            )
        return Path(given)
    usable = [
        (rank, -_major(version), path)
        for rank, path in _candidates()
        if (version := llvm_version(path)) is not None and _major(version) >= OLDEST_LLVM
    ]
    return Path(min(usable)[2]) if usable else None


def _require_llvm() -> Path:
    library = find_llvm()
    if library is None:
        raise BackendError(f"no usable LLVM found. {FIX}")
    return library


def _candidates() -> list[tuple[int, str]]:
    """Libraries by rank: 0 the wheel's, 1 the system's."""
    wheel = [str(p) for p in sorted((Path(sys.prefix) / "lib").glob("libLLVM*.so*"))]
    system = [
        str(path)
        for folder in ("/usr/lib/x86_64-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/local/lib")
        for path in sorted(Path(folder).glob("libLLVM*.so*"))
    ]
    named = ctypes.util.find_library("LLVM")
    found = [(0, p) for p in wheel] + [(1, p) for p in [*system, *([named] if named else [])]]
    real: dict[str, tuple[int, str]] = {}
    for rank, path in found:
        real.setdefault(os.path.realpath(path), (rank, path))
    return list(real.values())


@lru_cache(maxsize=64)
def llvm_version(path: str) -> str | None:
    """Ask a libLLVM for its version in a child process; None where it has none or is broken."""
    try:
        child = subprocess.run(
            [sys.executable, "-c", _ASK, path], capture_output=True, text=True, timeout=60
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return child.stdout.strip() if child.returncode == 0 else None


def _major(version: str) -> int:
    return int(version.split(".")[0])


@lru_cache(maxsize=1)
def cuda_works() -> bool:
    """Render a small scene on the GPU in a child process, where a driver is present."""
    if ctypes.util.find_library("cuda") is None and not Path("/dev/nvidiactl").exists():
        return False
    try:
        child = subprocess.run(
            [sys.executable, "-c", _PROBE_CUDA], capture_output=True, text=True, timeout=180
        )
    except (OSError, subprocess.SubprocessError):
        return False
    # Mitsuba logs to stdout, before the answer or after it, in colours.
    return child.returncode == 0 and "lit" in child.stdout.split()


def _active() -> str | None:
    module = sys.modules.get("mitsuba")
    if module is None or "drjit" not in sys.modules:
        return None
    name = module.variant()
    return str(name) if name else None
