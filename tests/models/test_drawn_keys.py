"""What a hand's file holds for pictures must fit the hand."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.models import load
from synthgen.models.files import load_content


@lru_cache(maxsize=1)
def whole() -> dict[str, Any]:
    """What a converted hand of ours holds."""
    return dict(load_content("cc0-hand").arrays)


def test_smoke_the_shipped_files_pass(tmp_path: Path) -> None:
    np.savez(tmp_path / "hand.npz", **whole())
    loaded = load(tmp_path / "hand.npz")
    np.testing.assert_array_equal(loaded.faces, load("cc0-hand").faces)


@pytest.mark.parametrize(
    ("key", "change", "words"),
    [
        ("uv", lambda a: a[:, 0], "uv is (2337,); expected (n, 2)"),
        ("uv", lambda a: a[:-1], "uv_faces refers to 2336"),
        ("uv", lambda a: np.where(np.arange(2) == 1, np.nan, a), "uv holds NaN"),
        ("uv", None, "no uv;"),
        ("uv_faces", lambda a: a[:-1], "uv_faces is (4141, 3); expected (4142, 3)"),
        ("uv_faces", lambda a: a.astype(int) - 1, "lowest -1"),
        ("uv_faces", lambda a: a + 0.5, "whole numbers"),
        ("arm_faces", lambda a: a.ravel(), "arm_faces is (2838,)"),
        ("arm_faces", lambda a: a.astype(int) + 10**6, "arm_faces refers to"),
        ("arm_end_ids", lambda a: a[:0], "arm_end_ids is (0,); expected (n)"),
        ("arm_template", lambda a: 3.0, "arm_template is (); expected (n, 3)"),
        ("arm_shapedirs", lambda a: a[..., :-1], "expected (476, 3, 10)"),
        ("arm_weights", lambda a: 0 * a, "arm_weights do not sum to 1"),
        ("mask_nail", lambda a: a[:-1], "mask_nail is (2084,); expected (2085)"),
    ],
)
def test_edge_each_key(tmp_path: Path, key: str, change: Any, words: str) -> None:
    arrays = dict(whole())
    if change is None:
        del arrays[key]
    else:
        arrays[key] = np.asarray(change(arrays[key]))
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(ModelError, match=re.escape(words)) as caught:
        load(tmp_path / "bad.npz")
    assert "bad.npz" in str(caught.value)
