"""Registration: fitting hands and bodies to scans, and knowing whether a fit can be trusted."""

from synthgen.registration.fit import fit, fit_many
from synthgen.registration.fitted import Fit
from synthgen.registration.template import Aligned, subject_template
from synthgen.registration.tracking import Track, track
from synthgen.registration.verdict import REASONS

__all__ = ["REASONS", "Aligned", "Fit", "Track", "fit", "fit_many", "subject_template", "track"]
