"""Settings of every test: one thread per pool, and property tests without a clock."""

from __future__ import annotations

import os

import hypothesis

for _pool in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_pool, "1")

hypothesis.settings.register_profile("synthgen", deadline=None, derandomize=True, max_examples=50)
hypothesis.settings.load_profile("synthgen")
