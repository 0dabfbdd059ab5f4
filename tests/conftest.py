"""Settings of every test: one thread per pool, property tests without a clock, an own cache."""

from __future__ import annotations

import os
from collections.abc import Iterator

import hypothesis
import pytest

for _pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")

hypothesis.settings.register_profile("synthgen", deadline=None, derandomize=True, max_examples=50)
hypothesis.settings.load_profile("synthgen")


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the user's cache out of the tests, and the tests out of the user's cache."""
    before, folder = os.environ.get("SYNTHGEN_CACHE"), tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # what one process has baked, the others read
        folder = folder.parent
    os.environ["SYNTHGEN_CACHE"] = str(folder / "cache")
    yield
    if before is None:
        del os.environ["SYNTHGEN_CACHE"]
    else:
        os.environ["SYNTHGEN_CACHE"] = before
