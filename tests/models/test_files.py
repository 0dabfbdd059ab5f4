"""Loading: shipped models, users' MANO files in their published form, and bad files."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.models import list_models, load


def _files() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "mano_files", Path(__file__).with_name("mano_files.py")
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mano_files"] = module
    spec.loader.exec_module(module)
    return module


FILES = _files()


def test_smoke_shipped_hand() -> None:
    assert "cc0-hand" in list_models()
    assert load("cc0-hand").hand == "right"
    assert load("cc0-hand", hand="left").hand == "left"


@pytest.mark.parametrize("protocol", [2, 4])
def test_reference_published_pickle_equals_npz(tmp_path: Path, protocol: int) -> None:
    content = FILES.arrays()
    FILES.write_pickle(tmp_path / "MANO_RIGHT.pkl", content, protocol)
    np.savez(tmp_path / "clean.npz", **content)
    a, b = load(tmp_path / "MANO_RIGHT.pkl"), load(tmp_path / "clean.npz")
    for name in ("v_template", "shapedirs", "posedirs", "weights", "J_regressor", "parents"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_array_equal(a.shapedirs, content["shapedirs"])
    assert a.parents[0] == -1
    assert a.digest == b.digest


def test_properties_arm_is_lofted_onto_the_wrist(tmp_path: Path) -> None:
    np.savez(tmp_path / "hand.npz", **FILES.arrays())
    model = load(tmp_path / "hand.npz")
    arm = model.surface.arm
    assert np.ptp(arm.template[:, 0]) > 0.45
    np.testing.assert_allclose(arm.weights.sum(axis=1), 1, atol=1e-12)
    from synthgen.geometry.topology import boundary_loops

    loops = boundary_loops(model.surface.faces)
    assert len(loops) == 1
    assert set(loops[0]) == set(arm.end_ids)
    assert model.surface.uv.min() >= 0
    assert model.surface.uv.max() <= 1


def test_properties_left_shape_bug_is_mended(tmp_path: Path) -> None:
    right = FILES.arrays()
    sign = np.array([-1.0, 1, 1])
    left = {**right, "v_template": right["v_template"] * sign, "f": right["f"][:, ::-1]}
    np.savez(tmp_path / "MANO_RIGHT.npz", **right)
    np.savez(tmp_path / "MANO_LEFT.npz", **left)  # shapedirs as published: x not negated
    mended = load(tmp_path / "MANO_LEFT.npz", hand="left")
    np.testing.assert_array_equal(mended.shapedirs, right["shapedirs"] * sign[:, None])
    kept = load(tmp_path / "MANO_LEFT.npz", hand="left", official_left_shape=True)
    np.testing.assert_array_equal(kept.shapedirs, right["shapedirs"])


def test_properties_folders_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez(tmp_path / "mine.npz", **FILES.arrays())
    monkeypatch.setenv("SYNTHGEN_MODELS", str(tmp_path))
    assert load("mine").v_template.shape == FILES.arrays()["v_template"].shape
    with pytest.raises(ModelError, match="did you mean 'mine'"):
        load("mime")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("weights", None, "no weights"),
        ("posedirs", np.zeros((241, 3, 9)), "posedirs is"),
        ("v_template", np.full((241, 3), np.nan), "NaN"),
        ("f", np.full((10, 3), 9999), "refer to vertex 9999"),
        ("weights", np.ones((241, 16)), "sum to 1"),
        ("kintree_table", np.tile(np.arange(16)[::-1], (2, 1)), "parents before children"),
        ("shapedirs", np.array(["text"]), "expected numbers"),
    ],
)
def test_edge_inconsistent(tmp_path: Path, key: str, value: Any, words: str) -> None:
    content = FILES.arrays()
    content.pop(key) if value is None else content.update({key: value})
    np.savez(tmp_path / "bad.npz", **content)
    with pytest.raises(ModelError, match=words):
        load(tmp_path / "bad.npz")


@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_edge_truncated(tmp_path: Path, suffix: str) -> None:
    whole = tmp_path / f"whole{suffix}"
    if suffix == ".npz":
        np.savez(whole, **FILES.arrays())
    else:
        FILES.write_pickle(whole, FILES.arrays())
    data = whole.read_bytes()
    for share in (0.0, 0.3, 0.9):
        cut = tmp_path / f"cut{int(share * 10)}{suffix}"
        cut.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(ModelError, match=cut.name):
            load(cut)


def test_edge_missing_and_bad_side() -> None:
    with pytest.raises(ModelError, match="SYNTHGEN_MODELS"):
        load("/nowhere/MANO_RIGHT.pkl")
    with pytest.raises(ModelError, match="'left' and 'right'"):
        load("cc0-hand", hand="both")  # type: ignore[arg-type]
