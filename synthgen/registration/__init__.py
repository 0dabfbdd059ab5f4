"""Registration: fitting a hand model to scans, and knowing whether the fit can be trusted."""

from synthgen.registration.fit import Fit, fit, fit_many
from synthgen.registration.verdict import REASONS

__all__ = ["REASONS", "Fit", "fit", "fit_many"]
