"""Benchmarks: one file each, a `run()` that returns a table; `make bench BENCH=name`."""
