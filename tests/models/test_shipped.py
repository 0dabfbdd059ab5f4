"""Files with more than the published keys, and the compact form of shipped bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import body_files
import mano_files
import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.models import load, load_hand, separate
from synthgen.models.shipped import shipped_extras


def compact(content: dict[str, Any]) -> dict[str, Any]:
    """The compact form of a small SMPL+H body whose arrays fit it without loss."""
    k, v = content["J_regressor"].shape
    joint = np.argsort(-content["weights"], axis=1)[:, :4]
    blocks = content["posedirs"].reshape(v, 3, k - 1, 9).transpose(0, 2, 1, 3)
    vertex, corrected = np.nonzero(np.abs(blocks).max(axis=(2, 3)) > 0)
    row, column = np.nonzero(content["J_regressor"])
    scale = np.abs(content["shapedirs"]).max(axis=(0, 1)) / 32767
    return {
        "shipped_form": "smplh",
        "v_template": content["v_template"],
        "f": content["f"],
        "kintree_table": content["kintree_table"],
        "shapedirs_q": np.round(content["shapedirs"] / scale).astype(np.int16),
        "shapedirs_scale": scale,
        "weights_joint": joint.astype(np.uint8),
        "weights_value": np.take_along_axis(content["weights"], joint, axis=1),
        "J_regressor_row": row,
        "J_regressor_column": column,
        "J_regressor_value": content["J_regressor"][row, column],
        "posedirs_vertex": vertex,
        "posedirs_joint": corrected + 1,
        "posedirs_blocks": np.round(blocks[vertex, corrected] / 1e-6).astype(np.int16),
        "posedirs_scale": 1e-6,
        "hands_mean": np.zeros(45),
        "hands_components": np.eye(45),
        "hands_coeffs": np.zeros((2, 45)),
        "part_left_foot": np.arange(5),
        "garment_template": np.ones((4, 3)),
    }


def test_reference_compact_bodies(tmp_path: Path) -> None:
    content = body_files.body("smplh")
    np.savez_compressed(tmp_path / "small.npz", **compact(content))
    model = load(tmp_path / "small.npz")
    np.testing.assert_allclose(model.shapedirs, content["shapedirs"], atol=1e-6)
    np.testing.assert_allclose(model.posedirs, content["posedirs"], atol=6e-7)
    np.testing.assert_allclose(model.weights, content["weights"], atol=1e-6)
    np.testing.assert_allclose(model.J_regressor, content["J_regressor"], atol=1e-12)
    assert model.hands_left is not None
    assert separate(model, "left_foot").vertex_ids.tolist() == [0, 1, 2, 3, 4]
    extras = shipped_extras(tmp_path / "small.npz")
    np.testing.assert_array_equal(extras["garment_template"], np.ones((4, 3)))
    assert "v_template" not in extras


def test_reference_quantised_hands_and_unknown_keys(tmp_path: Path) -> None:
    content = mano_files.arrays()
    integers = np.round(content.pop("posedirs") / 1e-7).astype(np.int16)
    np.savez(tmp_path / "hand.npz", posedirs_q=integers, posedirs_scale=1e-7, later=np.ones(3),
             **content)  # fmt: skip
    model = load_hand(tmp_path / "hand.npz")
    np.testing.assert_allclose(model.posedirs, integers * 1e-7, atol=0)
    assert shipped_extras(tmp_path / "hand.npz").keys() == {"later"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shapedirs_scale": None}, "'shapedirs_scale'"),
        ({"shapedirs_scale": np.ones(5)}, "compact form"),
        ({"posedirs_joint": np.array([99])}, "compact form"),
        ({"shipped_form": "smplx"}, "'smplx'"),
        ({"part_left_foot": np.array([999])}, "part_left_foot"),
    ],
)
def test_edge_damaged_compact_form(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    content = compact(body_files.body("smplh")) | change
    np.savez(tmp_path / "bad.npz", **{k: v for k, v in content.items() if v is not None})
    with pytest.raises(ModelError, match=words) as caught:
        load(tmp_path / "bad.npz")
    assert "bad.npz" in str(caught.value)


def test_edge_scale_of_a_hand(tmp_path: Path) -> None:
    content = mano_files.arrays()
    content["posedirs_q"] = np.zeros_like(content.pop("posedirs"), dtype=np.int16)
    np.savez(tmp_path / "bad.npz", **content)
    with pytest.raises(ModelError, match="posedirs_scale is missing"):
        load(tmp_path / "bad.npz")
