"""Building blocks: strictness, ranges, weights."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from synthgen.config.sections import FovRange, Section, Weight, Weighted


class Lens(Section):
    fov: FovRange = (20.0, 40.0)


class Choice(Weighted):
    one: Weight = 1.0
    two: Weight = 0.0


def test_smoke() -> None:
    assert Lens().fov == (20.0, 40.0)


def test_edge_unknown_key() -> None:
    with pytest.raises(ValidationError, match="extra_forbidden"):
        Lens.model_validate({"fow": (1, 2)})


@pytest.mark.parametrize("pair", [(40.0, 20.0), (1.0, 20.0), (20.0, 121.0), (float("nan"), 20.0)])
def test_edge_ranges(pair: tuple[float, float]) -> None:
    with pytest.raises(ValidationError):
        Lens(fov=pair)


def test_edge_equal_ends_are_a_fixed_value() -> None:
    assert Lens(fov=(30.0, 30.0)).fov == (30.0, 30.0)


def test_edge_weights() -> None:
    assert Choice().weights() == {"one": 1.0, "two": 0.0}
    with pytest.raises(ValidationError, match="positive weight"):
        Choice(one=0.0)
    with pytest.raises(ValidationError):
        Choice(one=-1.0, two=2.0)
