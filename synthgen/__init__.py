"""synthgen: synthetic hands with labels that are checked."""

__version__ = "0.1.0"
