"""synthgen: synthetic hands with labels that are checked.

>>> import synthgen
>>> corpus = synthgen.open_corpus("out/demo")          # doctest: +SKIP
>>> model = synthgen.models.load("cc0-hand", hand="left")  # doctest: +SKIP

Importing the package is light: rooms are loaded when they are first asked for, and only
``synthgen.render`` brings in Mitsuba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synthgen import (
        config,
        corpus,
        geometry,
        models,
        registration,
        sampling,
        scanner,
        scene,
        verify,
    )
    from synthgen.corpus import open_corpus

__version__ = "0.1.0"

__all__ = [
    "__version__",
    "config",
    "corpus",
    "geometry",
    "models",
    "open_corpus",
    "registration",
    "sampling",
    "scanner",
    "scene",
    "verify",
]


def __getattr__(name: str) -> Any:
    """Load a room, or the one function at the top, on first use."""
    from importlib import import_module

    if name == "open_corpus":
        return import_module("synthgen.corpus").open_corpus
    if name in __all__:
        return import_module(f"synthgen.{name}")
    raise AttributeError(f"module 'synthgen' has no attribute {name!r}; it has {__all__}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
