"""The one tree of errors that synthgen raises on purpose.

Every message names the value that was refused, what would have been allowed and what to do next.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class SynthgenError(Exception):
    """Base of every error that synthgen raises on purpose; the command line exits with 2."""


class ConfigError(SynthgenError):
    """A preset, a configuration key or a ``--set`` argument is wrong."""


class ModelError(SynthgenError):
    """A body or hand model is missing, unreadable, hostile or inconsistent."""


class ShapeError(SynthgenError, ValueError):
    """An array argument has a shape, dtype or value that the function cannot take."""


class BackendError(SynthgenError):
    """No working Mitsuba / Dr.Jit back end can be set up on this machine."""


class SamplingError(SynthgenError):
    """A sampler cannot meet the configuration (for example: no pose passed its checks)."""


class FileError(SynthgenError):
    """A picture or panorama of the user's is missing, unreadable, hostile or has changed."""


class ScanError(SynthgenError):
    """A rig, a unit or a scene cannot be scanned; the message names the unit and says why."""


class CorpusError(SynthgenError):
    """A corpus cannot be written, resumed or read."""


class IntegrityError(CorpusError):
    """Stored bytes differ from what their checksum or index says."""


class WorkLeft(SynthgenError):  # noqa: N818  (it is no failure: the same command goes on)
    """Work was interrupted; the same command resumes (the command line exits with 3)."""


def nearest(word: str, allowed: Iterable[str]) -> str:
    """Return ``" - did you mean 'x'?"`` for the closest allowed word, or an empty string."""
    found = difflib.get_close_matches(word, list(allowed), n=1, cutoff=0.5)
    return f" - did you mean {found[0]!r}?" if found else ""
