"""One thread per pool in worker processes: pools that fight cost more than they give."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

_POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@contextmanager
def single_threaded_children() -> Iterator[None]:
    """Let processes that are started inside this context begin with one thread per pool."""
    before = {name: os.environ.get(name) for name in _POOLS}
    os.environ.update(dict.fromkeys(_POOLS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
