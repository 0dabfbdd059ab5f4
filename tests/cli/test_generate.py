"""``synthgen generate``: its options; the job itself is tested in tests/promises."""

from __future__ import annotations

import pytest

from synthgen.cli.generate import shard_range
from synthgen.errors import ConfigError


def test_smoke() -> None:
    assert shard_range(None) is None
    assert shard_range("0:8") == (0, 8)


@pytest.mark.parametrize("text", ["", "3", ":", "3:", ":3", "a:b", "3:3", "4:3", "-1:2", "1:2:3"])
def test_edge_shards(text: str) -> None:
    with pytest.raises(ConfigError, match="--shards"):
        shard_range(text)
