"""The analytic speckle pictures as an importable module, and pairs made of them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

HERE = str(Path(__file__).parent)
if HERE not in sys.path:
    sys.path.insert(0, HERE)


@pytest.fixture(scope="session")
def seen() -> Any:
    """Return a maker of (pair, left, right, true disparity), one exposure per surface."""
    import speckle

    made: dict[Any, Any] = {}

    def make(surface: Any) -> Any:
        if surface not in made:
            made[surface] = speckle.rectified_view(surface)
        return made[surface]

    return make
