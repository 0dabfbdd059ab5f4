"""Checking a corpus against the truth it was made from."""

from synthgen.verify.labels import verify
from synthgen.verify.report import Failure, VerifyReport

__all__ = ["Failure", "VerifyReport", "verify"]
