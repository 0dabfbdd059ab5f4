"""Writing models out and reading them back is exact."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import body_files
import mano_files
import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.models import convert, load, load_content, load_hand, separate
from synthgen.models.model import Hand


def source(family: str, folder: Path, pairs: int = 60) -> Path:
    if family == "mano":
        raw = body_files.raw_mano(mano_files.arrays())
        return body_files.write_python2(folder / "MANO_RIGHT.pkl", raw)
    content = body_files.body(family.removesuffix("-constrained"), pairs=pairs)
    if family == "smplh":
        raw = body_files.raw_smplh(content) | body_files.hands()
        return body_files.write_python2(folder / "SMPLH_male.pkl", raw)
    if family == "star":
        np.savez(folder / "star.npz", **content)
        return folder / "star.npz"
    meta = body_files.axis_meta(75, 20, 5) if family.endswith("constrained") else None
    return body_files.write_supr(folder / "supr.npy", content, meta)


def equal(a: Path | str, b: Path | str) -> None:
    one, two = load_content(a), load_content(b)
    assert one.arrays.keys() == two.arrays.keys()
    for key, array in one.arrays.items():
        np.testing.assert_array_equal(two.arrays[key], array)
        assert two.arrays[key].dtype == array.dtype, key
    assert (one.digest, one.family) == (two.digest, two.family)
    assert (one.meta is None) == (two.meta is None)
    for key, value in (one.meta or {}).items():
        np.testing.assert_array_equal(two.meta[key], value)


@pytest.mark.parametrize(
    ("family", "suffix"),
    [("mano", ".pkl"), ("smplh", ".pkl"), ("supr", ".npy"), ("supr-constrained", ".npy"),
     ("star", ".npz")],
)  # fmt: skip
def test_reference_there_and_back(family: str, suffix: str, tmp_path: Path) -> None:
    start = source(family, tmp_path)
    clean = convert(start, tmp_path / "out" / "clean.npz")
    official = convert(clean, tmp_path / f"official{suffix}")
    equal(start, clean)
    equal(start, official)
    assert load(clean).digest == load(official).digest == load(start).digest
    with np.load(clean, allow_pickle=False) as archive:
        assert "v_template" in archive.files
    again = convert(official, tmp_path / f"again{suffix}")
    assert again.read_bytes() == official.read_bytes()


@pytest.mark.parametrize("suffix", [".pkl", ".npz"])
def test_reference_the_shipped_hand(suffix: str, tmp_path: Path) -> None:
    path = convert("cc0-hand", tmp_path / f"hand{suffix}")
    equal("cc0-hand", path)
    mine, ours = load_hand(path), load_hand("cc0-hand")
    assert mine.digest == ours.digest
    np.testing.assert_array_equal(mine.surface.uv, ours.surface.uv)
    assert mine.provenance == ours.provenance


def test_reference_other_readers_open_them(tmp_path: Path) -> None:
    """Plain arrays and text, for those who read the published files (and so say latin1)."""
    content = source("smplh", tmp_path)
    data = convert(content, tmp_path / "a.pkl").read_bytes()
    found: Any = pickle.loads(data, encoding="latin1")  # noqa: TID251
    assert found["bs_style"] == "lbs"
    np.testing.assert_array_equal(found["posedirs"], load(content).posedirs)
    supr = convert(source("supr-constrained", tmp_path), tmp_path / "b.npy")
    values = np.load(supr, allow_pickle=True)[()]
    assert values["axis_meta"]["num_pose"] == 180
    assert values["J_regressor"].shape == (225, 385)


def test_reference_a_merged_file_holds_the_pose_spaces(tmp_path: Path) -> None:
    raw = body_files.raw_smplh(body_files.body("smplh"))
    body = body_files.write_python2(tmp_path / "SMPLH_male.pkl", raw)
    (tmp_path / "hands").mkdir()
    hand = source("mano", tmp_path / "hands")
    merged = convert(body, tmp_path / "merged.npz", mano=(hand, hand))
    assert load(body).hands_left is None
    space = load(merged).hands_left
    assert space is not None
    np.testing.assert_array_equal(space.mean, mano_files.arrays()["hands_mean"])


@pytest.mark.parametrize("name", ["cc0-hand", "mano"])
@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_reference_the_other_hand(name: str, suffix: str, tmp_path: Path) -> None:
    start = name if name == "cc0-hand" else source("mano", tmp_path)
    path = convert(start, tmp_path / f"other{suffix}", hand="left")
    written, ours = load_hand(path, hand="left"), load_hand(start, hand="left")
    for key in ("v_template", "shapedirs", "posedirs", "faces", "hands_mean", "hands_components"):
        np.testing.assert_array_equal(getattr(written, key), getattr(ours, key))
    if name == "cc0-hand":  # an arm that comes with the file; others are lofted when they are read
        np.testing.assert_array_equal(written.surface.arm.template, ours.surface.arm.template)
    again = convert(path, tmp_path / f"again{suffix}", hand="right")
    np.testing.assert_array_equal(load_hand(again).posedirs, load_hand(start).posedirs)


@pytest.mark.parametrize("family", ["supr", "supr-constrained", "smplh", "star"])
@pytest.mark.parametrize("official", [False, True])
def test_reference_a_part_of_a_body(family: str, official: bool, tmp_path: Path) -> None:
    start = source(family, tmp_path, pairs=800)
    suffix = {"supr": ".npy", "smplh": ".pkl"}.get(family[:5].rstrip("-"), ".npz")
    path = convert(start, tmp_path / f"part{suffix if official else '.npz'}", part="right_hand")
    found, cut = load(path), separate(load(start), "right_hand")
    assert found.joint_names == cut.model.joint_names
    assert (found.hands_left is None) == (cut.model.hands_left is None)
    assert (found.hands_right is None) == (family != "smplh")
    pose = np.full((1, found.n_pose), 0.1)
    pose = pose if found.axis_meta is not None else pose.reshape(1, -1, 3)
    a, ja = found.evaluate_reference(np.ones((1, 3)), pose)
    b, jb = cut.model.evaluate_reference(np.ones((1, 3)), pose)
    np.testing.assert_allclose(a, b, atol=1e-9)
    np.testing.assert_allclose(ja, jb, atol=1e-9)


def test_edge_no_such_hand_or_part(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="is no hand"):
        convert(source("star", tmp_path), tmp_path / "x.npz", hand="left")
    with pytest.raises(ModelError, match="is a hand already"):
        convert("cc0-hand", tmp_path / "x.npz", part="head")


def test_edge_targets(tmp_path: Path) -> None:
    path = source("supr", tmp_path)
    with pytest.raises(ModelError, match=r"\.pkl is not how supr models are written; .*\.npy"):
        convert(path, tmp_path / "x.pkl")
    with pytest.raises(ModelError, match="no suffix"):
        convert(path, tmp_path / "x")
    (tmp_path / "file").write_text("")
    with pytest.raises(ModelError, match="cannot be written"):
        convert(path, tmp_path / "file" / "x.npz")
    assert not list(tmp_path.glob(".making-*"))


@pytest.mark.parametrize(("name", "target"), [("LEFT", "mine"), ("RIGHT", "from_left")])
@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_properties_a_hand_keeps_its_side(
    name: str, target: str, suffix: str, tmp_path: Path
) -> None:
    """Of many files only the name tells the side: a new name must not make it the other hand."""
    start = tmp_path / f"MANO_{name}.pkl"
    mano_files.write_pickle(start, mano_files.arrays())
    side: Hand = "left" if name == "LEFT" else "right"
    path = convert(start, tmp_path / f"{target}{suffix}")
    a, b = load_hand(start, hand=side), load_hand(path, hand=side)
    np.testing.assert_array_equal(a.v_template, b.v_template)
    np.testing.assert_array_equal(a.posedirs, b.posedirs)
