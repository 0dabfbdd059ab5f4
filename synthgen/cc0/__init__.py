"""Builds the shipped CC0 models from MakeHuman data; run by hand, the result is shipped."""

from synthgen.cc0.build import build

__all__ = ["build"]
