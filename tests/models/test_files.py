"""Loading: shipped models, users' MANO files in their published form, and bad files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import body_files
import mano_files
import numpy as np
import pytest
from test_pickles import bounded

from synthgen.errors import ModelError
from synthgen.models import ManoModel, list_models, load, load_hand
from synthgen.models import joints as tables
from synthgen.models.left_shape import against_growth
from synthgen.sampling.streams import stream


def test_smoke_shipped_hand() -> None:
    assert "cc0-hand" in list_models()
    assert load("cc0-hand").hand == "right"
    assert load("cc0-hand", hand="left").hand == "left"


@pytest.mark.parametrize("protocol", [2, 4])
def test_reference_published_pickle_equals_npz(tmp_path: Path, protocol: int) -> None:
    content = mano_files.arrays()
    mano_files.write_pickle(tmp_path / "MANO_RIGHT.pkl", content, protocol)
    np.savez(tmp_path / "clean.npz", **content)
    a, b = load(tmp_path / "MANO_RIGHT.pkl"), load(tmp_path / "clean.npz")
    for name in ("v_template", "shapedirs", "posedirs", "weights", "J_regressor", "parents"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_array_equal(a.shapedirs, content["shapedirs"])
    assert a.parents[0] == -1
    assert a.digest == b.digest


def test_properties_arm_is_lofted_onto_the_wrist(tmp_path: Path) -> None:
    np.savez(tmp_path / "hand.npz", **mano_files.arrays())
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


@pytest.mark.parametrize("protocol", [0, 1, 2])
def test_reference_files_as_python_2_wrote_them(tmp_path: Path, protocol: int) -> None:
    content = mano_files.arrays()
    path = tmp_path / "MANO_RIGHT.pkl"
    model = load(body_files.write_python2(path, body_files.raw_mano(content), protocol))
    assert isinstance(model, ManoModel)
    for name in ("v_template", "shapedirs", "posedirs", "weights", "J_regressor", "hands_mean"):
        np.testing.assert_array_equal(getattr(model, name), content[name])


@pytest.mark.parametrize("protocol", [0, 1, 2])
def test_reference_raw_smplh(tmp_path: Path, protocol: int) -> None:
    content = body_files.body("smplh")
    path = tmp_path / "SMPLH_male.pkl"
    model = load(body_files.write_python2(path, body_files.raw_smplh(content), protocol))
    for name in ("v_template", "shapedirs", "posedirs", "weights", "J_regressor"):
        np.testing.assert_array_equal(getattr(model, name), content[name])
    assert (model.family, model.hand, len(model.parents)) == ("smplh", None, 52)
    assert model.joint_names[22] == "left_index1"
    assert "mano=(left file, right file)" in model.warnings[0]
    with pytest.raises(ModelError, match="MANO pair"):
        model.evaluate(np.zeros((1, 1)), np.zeros((1, 78)), flat_hand_mean=True)


@pytest.mark.parametrize("betas", [10, 16])
@pytest.mark.parametrize("suffix", [".pkl", ".npz"])
def test_reference_merged_smplh(tmp_path: Path, suffix: str, betas: int) -> None:
    content = body_files.body("smplh", betas=betas) | body_files.hands()
    path = tmp_path / f"SMPLH_MALE{suffix}"
    if suffix == ".npz":
        np.savez(path, **content)
    else:
        body_files.write_python2(path, content | {"J_regressor": body_files.csc(
            content["J_regressor"], "scipy.sparse._csc")})  # fmt: skip
    model = load(path)
    assert model.n_shape == betas
    assert model.hands_left is not None
    np.testing.assert_array_equal(model.hands_left.components, content["hands_componentsl"])
    posed = model.evaluate(np.zeros((1, betas)), np.zeros((1, 78)), flat_hand_mean=False)
    assert posed.vertices.shape == (1, 128, 3)


def pair(folder: Path) -> dict[str, Any]:
    right = mano_files.arrays()
    left = right | {"hands_mean": right["hands_mean"] + 1}
    for name, content in (("MANO_RIGHT", right), ("MANO_LEFT", left)):
        body_files.write_python2(folder / f"{name}.pkl", body_files.raw_mano(content))
    return right


def test_reference_raw_body_and_mano_pair(tmp_path: Path) -> None:
    """The four files as they are downloaded: merged in memory, beside each other or named."""
    (tmp_path / "hands").mkdir()
    right = pair(tmp_path / "hands")
    raw = body_files.raw_smplh(body_files.body("smplh"))
    path = body_files.write_python2(tmp_path / "SMPLH_male.pkl", raw)
    assert load(path).hands_left is None
    hands = tuple(tmp_path / "hands" / f"MANO_{side}.pkl" for side in ("LEFT", "RIGHT"))
    named = load(path, mano=hands)
    beside = load(body_files.write_python2(tmp_path / "hands" / "SMPLH_male.pkl", raw))
    for model in (named, beside):
        assert model.hands_left is not None
        assert model.hands_right is not None
        np.testing.assert_array_equal(model.hands_right.mean, right["hands_mean"])
        np.testing.assert_array_equal(model.hands_left.mean, right["hands_mean"] + 1)
        assert "MANO_LEFT.pkl" in model.warnings[0]
    np.savez(tmp_path / "no.npz", v_template=np.zeros((3, 3)))
    with pytest.raises(ModelError, match=r"no\.npz: no hands_mean"):
        load(path, mano=(tmp_path / "no.npz", hands[1]))


@pytest.mark.parametrize("features", [300, 296])
def test_reference_supr(tmp_path: Path, features: int) -> None:
    content = body_files.body("supr")
    content["posedirs"] = content["posedirs"][:, :, 300 - features :]
    model = load(body_files.write_supr(tmp_path / "supr_male.npy", content))
    np.testing.assert_array_equal(model.J_regressor, content["J_regressor"])
    assert (model.family, model.parents[0], len(model.joint_names)) == ("supr", -1, 75)
    flat = content | {"posedirs": content["posedirs"].reshape(-1, features)}
    again = load(body_files.write_supr(tmp_path / "flat.npy", flat))
    np.testing.assert_array_equal(again.posedirs, model.posedirs)


def test_reference_constrained_supr(tmp_path: Path) -> None:
    meta = body_files.axis_meta(75, 20, 5)
    model = load(body_files.write_supr(tmp_path / "c.npy", body_files.body("supr"), meta))
    assert model.axis_meta is not None
    assert model.axis_meta.n_pose == meta["num_pose"] == 180
    assert "axes on wrong joints" in model.warnings[0]
    assert json.loads(model.provenance)["sha256"]


def test_reference_star(tmp_path: Path) -> None:
    np.savez(tmp_path / "model.npz", **body_files.body("star"))
    model = load(tmp_path / "model.npz")
    assert (model.family, len(model.parents)) == ("star", 24)


def test_properties_left_shape_bug_is_mended(tmp_path: Path) -> None:
    right = mano_files.arrays()
    sign = np.array([-1.0, 1, 1])
    left = {**right, "v_template": right["v_template"] * sign, "f": right["f"][:, ::-1]}
    np.savez(tmp_path / "MANO_RIGHT.npz", **right)
    np.savez(tmp_path / "MANO_LEFT.npz", **left)  # shapedirs as published: x not negated
    mended = load(tmp_path / "MANO_LEFT.npz", hand="left")
    np.testing.assert_array_equal(mended.shapedirs, right["shapedirs"] * sign[:, None])
    kept = load(tmp_path / "MANO_LEFT.npz", hand="left", official_left_shape=True)
    np.testing.assert_array_equal(kept.shapedirs, right["shapedirs"])
    assert json.loads(mended.provenance)["left_shape"] == "mended"
    assert json.loads(kept.provenance)["left_shape"] == "official"
    assert "wrong sign" in kept.warnings[0]
    assert mended.digest != kept.digest

    other = load(tmp_path / "MANO_LEFT.npz", hand="right", official_left_shape=True)
    np.testing.assert_array_equal(other.shapedirs, right["shapedirs"])
    with pytest.raises(ModelError, match="published left hand's own file"):
        load(tmp_path / "MANO_RIGHT.npz", hand="left", official_left_shape=True)


def test_reference_joints_numbered_as_in_the_body_they_were_cut_from(tmp_path: Path) -> None:
    content = body_files.body("supr")
    content["kintree_table"] = content["kintree_table"].astype(np.int64) + 100
    content["kintree_table"][0, 0] = 0
    model = load(body_files.write_supr(tmp_path / "part.npy", content))
    assert tuple(model.parents) == tables.SUPR75_PARENTS
    content["kintree_table"][0, 7] = 999
    with pytest.raises(ModelError, match=r"column 7 is \[999.0, 107.0\]"):
        load(body_files.write_supr(tmp_path / "bad.npy", content))


def test_properties_left_shape_without_its_twin(tmp_path: Path) -> None:
    """A hand that grows along y and z but shrinks along x gives the bug away."""
    hand = load_hand("cc0-hand")
    sign = np.array([-1.0, 1, 1])
    left = {
        "v_template": hand.v_template * sign, "f": hand.faces[:, ::-1], "weights": hand.weights,
        "J_regressor": hand.J_regressor, "kintree_table": np.stack([hand.parents, hand.parents]),
        "posedirs": hand.posedirs, "hands_mean": hand.hands_mean,
        "hands_components": hand.hands_components, "fingertip_ids": hand.fingertip_ids,
    }  # fmt: skip
    right_way = hand.shapedirs * sign[:, None]
    np.savez(tmp_path / "MANO_LEFT.npz", shapedirs=hand.shapedirs, **left)
    np.testing.assert_array_equal(
        load(tmp_path / "MANO_LEFT.npz", hand="left").shapedirs, right_way
    )
    np.savez(tmp_path / "good_left.npz", shapedirs=right_way, **left)
    good = load(tmp_path / "good_left.npz", hand="left")
    np.testing.assert_array_equal(good.shapedirs, right_way)
    assert json.loads(good.provenance)["left_shape"] == "as in file"
    assert not good.warnings


def test_properties_growth_is_told_from_noise() -> None:
    rng = stream(0, "sample", 0, 0, "growth")
    v = rng.normal(size=(300, 3))
    noise = rng.normal(0, 0.3, (300, 3, 10))
    assert against_growth(v, noise) is None
    noise[..., 0] += v
    assert against_growth(v, noise) is False
    assert against_growth(v, noise * np.array([-1.0, 1, 1])[:, None]) is True


def test_edge_left_hand_that_cannot_be_judged(tmp_path: Path) -> None:
    np.savez(tmp_path / "MANO_LEFT.npz", **mano_files.arrays())
    model = load(tmp_path / "MANO_LEFT.npz", hand="left")
    assert "could not be judged" in model.warnings[0]


def test_properties_folders_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez(tmp_path / "mine.npz", **mano_files.arrays())
    monkeypatch.setenv("SYNTHGEN_MODELS", str(tmp_path))
    assert load("mine").v_template.shape == mano_files.arrays()["v_template"].shape
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
        ("shapedirs", np.zeros((241, 3)), r"shapedirs is \(241, 3\); expected 3 dimensions"),
        ("J_regressor", np.zeros((16, 240)), r"J_regressor is \(16, 240\); expected \(16, 241\)"),
        ("f", np.zeros((5, 4), int), r"f is \(5, 4\); expected \(5, 3\)"),
        ("f", np.array([[0, 1, -3]]), "refer to vertex -3"),
        ("weights", np.full((241, 16), np.inf), "NaN or infinity"),
        ("hands_components", None, r"no hands_components: .* expected hands_mean \(45,\)"),
        ("hands_mean", np.zeros(9), r"hands_mean is \(9,\)"),
        ("hands_coeffs", np.zeros((4, 9)), r"hands_coeffs is \(4, 9\); expected \(N, 45\)"),
        ("weights", np.full(241, 1.0), r"weights is \(241,\); expected 2 dimensions"),
        ("weights", np.tile([1.5, -0.5, *[0.0] * 14], (241, 1)), "vertex 0 go down to -0.5"),
        ("J_regressor", np.eye(16, 241) * (np.arange(16) != 3)[:, None], "only zeros for joint 3"),
        ("J_regressor", 1.2 * np.eye(16, 241), "joint 0 sums to 1.2; expected rows that sum to 1"),
        ("bs_type", "quaternion", "only 'lrotmin'"),
        ("v_template", np.zeros((0, 3)), "none 0"),
    ],
)
def test_edge_inconsistent(tmp_path: Path, key: str, value: Any, words: str) -> None:
    content = mano_files.arrays()
    content.pop(key) if value is None else content.update({key: value})
    np.savez(tmp_path / "bad.npz", **content)
    with pytest.raises(ModelError, match=words):
        load(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("family", "change", "words"),
    [
        ("smplh", {"posedirs": np.zeros((128, 3, 207)), "weights": 24}, "looks like SMPL: another"),
        ("smplh", {"posedirs": np.zeros((128, 3, 486)), "weights": 55}, "looks like SMPL-X"),
        ("smplh", {"hands_meanl": np.zeros(45)}, "no hands_componentsl"),
        ("supr", {"posedirs": np.zeros((128, 3, 290))}, r"expected \(128, 3, 300\) or"),
        ("supr", {"J_regressor": np.zeros((225, 384))}, "another family"),
        ("star", {"posedirs": np.zeros((128, 3, 92))}, "another family"),
        ("supr", {"axis_meta": {"num_pose": 3}}, "axis_meta has no indx_spherical"),
        ("supr", {"axis_meta": [1]}, "expected a dict"),
    ],
)
def test_edge_bodies(tmp_path: Path, family: str, change: dict[str, Any], words: str) -> None:
    content = body_files.body(family)
    if "weights" in change:  # a body of fewer or more joints
        k = change["weights"]
        weights = np.full((128, k), 1 / k)
        table = np.stack([np.maximum(np.arange(k) - 1, 0)] * 2)
        change = change | {"weights": weights, "kintree_table": table, "J_regressor": weights.T}
    np.save(tmp_path / "bad.npy", np.array(content | change, dtype=object), allow_pickle=True)
    with pytest.raises(ModelError, match=words) as caught:
        load(tmp_path / "bad.npy")
    assert "bad.npy" in str(caught.value)


HOSTILE = {
    "one joint": (
        {"weights": np.ones((128, 1)), "posedirs": np.zeros((128, 3, 0)),
         "J_regressor": np.ones((1, 128)) / 128, "kintree_table": np.zeros((2, 1))},
        "at least two joints",
    ),
    "expression without dimensions": ({"exprdirs": np.float64(3)}, "exprdirs is ()"),
    "beyond single precision": ({"v_template": np.full((128, 3), 1e308)}, "holds 1e+308"),
    "broken faces": ({"f": np.full((9, 3), 0.5)}, "vertex ids"),
    "names of few joints": ({"joint_names": np.array(["a", "b"])}, "expected 52 names"),
    "one name for all": ({"joint_names": np.array(["a"] * 52)}, "all different"),
    "axes of few joints": ({"joint_axes": np.zeros((3, 2))}, "joint_axes is (3, 2)"),
    "a scale that grows": (
        {"v_template_q": np.ones((20_000, 1), np.int16), "v_template_scale": np.ones((1, 20_000))},
        "does not fit v_template_q",
    ),
    "two types in one": ({"v_template": np.zeros(128, [("a", "f8"), ("b", "f8")])}, "dtype"),
    "odd key": ({"v\x1b[31m": np.zeros(3), "v_template": None}, r"v\x1b[31m"),
    "long key": ({"v" * 60_000: np.zeros(3), "v_template": None}, "v..."),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_edge_hostile(name: str, tmp_path: Path) -> None:
    change, words = HOSTILE[name]
    content = {k: v for k, v in (body_files.body("smplh") | change).items() if v is not None}
    np.savez(tmp_path / "bad.npz", **content)
    with bounded(), pytest.raises(ModelError, match=re.escape(words)) as caught:
        load(tmp_path / "bad.npz")
    assert "bad.npz" in str(caught.value)
    assert len(str(caught.value)) < 2000


def test_edge_a_compact_form_that_grows(tmp_path: Path) -> None:
    """Small arrays that declare a dense model of hundreds of gigabytes."""
    arrays = {
        "shipped_form": np.array("smplh"), "v_template": np.zeros((300_000, 3), np.float16),
        "kintree_table": np.zeros((2, 10_000), np.int8),
        "posedirs_blocks": np.zeros((1, 3, 9), np.int16),
    }  # fmt: skip
    np.savez(tmp_path / "bad.npz", **arrays)
    with bounded(), pytest.raises(ModelError, match="would take"):
        load(tmp_path / "bad.npz")


def test_properties_a_regressor_slightly_off_is_told(tmp_path: Path) -> None:
    content = mano_files.arrays()
    np.savez(tmp_path / "good.npz", **content)
    assert not load(tmp_path / "good.npz").warnings
    np.savez(tmp_path / "off.npz", **content | {"J_regressor": 1.01 * content["J_regressor"]})
    (words,) = load(tmp_path / "off.npz").warnings
    assert "sums to 1.01; expected rows that sum to 1" in words


@pytest.mark.parametrize("suffix", [".pkl", ".npy", ".npz"])
def test_edge_zeros_are_refused_by_their_head(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As large as a model may be: neither read nor hashed."""
    monkeypatch.setattr("synthgen.models.cache.sha256_of", None)
    path = tmp_path / f"zeros{suffix}"
    with path.open("wb") as stream:
        stream.truncate(299 * 2**20)
    with bounded(), pytest.raises(ModelError, match=r"zeros.*(starts with|no directory)"):
        load(path)


@pytest.mark.parametrize("text", ["<!DOCTYPE html>", "version https://git-lfs.github.com/spec/v1"])
def test_edge_what_was_saved_in_its_place(tmp_path: Path, text: str) -> None:
    (tmp_path / "MANO_RIGHT.pkl").write_text(text)
    with pytest.raises(ModelError, match=r"MANO_RIGHT.*web page or a pointer"):
        load(tmp_path / "MANO_RIGHT.pkl")


def test_edge_a_file_beyond_any_model_is_not_hashed(tmp_path: Path) -> None:
    with (tmp_path / "bad.pkl").open("wb") as stream:
        stream.truncate(10**11)
    with bounded(), pytest.raises(ModelError, match="at most"):
        load(tmp_path / "bad.pkl")


@pytest.mark.parametrize("name", ["a" * 5000 + ".npz", "a\0b.npz", "", 7, None])
def test_edge_no_name_of_a_file(name: Any) -> None:
    with pytest.raises(ModelError, match=r"no model|named by"):
        load(name)


def test_edge_constrained_tree_of_ragged_lists(tmp_path: Path) -> None:
    meta = body_files.axis_meta(75, 20, 5)
    meta["indx_spherical"] = [[1, 2, 3], [4]]
    path = body_files.write_supr(tmp_path / "c.npy", body_files.body("supr"), meta)
    with pytest.raises(ModelError, match="axis_meta"):
        load(path)


def test_edge_arrays_that_grow_when_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Small integers in place of numbers: eight times their size as float64."""
    content = mano_files.arrays()
    content["posedirs"] = np.zeros((241, 3, 135), dtype=np.int8)
    np.savez(tmp_path / "bad.npz", **content)
    monkeypatch.setattr("synthgen.models.content.MAX_BYTES", 700_000)
    with pytest.raises(ModelError, match=r"the largest, posedirs, is \(241, 3, 135\)"):
        load(tmp_path / "bad.npz")


@pytest.mark.parametrize("key", ["more_q", "uv", "mask_more", "fingertip_ids", "part_more"])
def test_edge_keys_of_our_own_that_grow_when_they_are_read(tmp_path: Path, key: str) -> None:
    """Zeros of one byte, packed to nothing, would take eight times as much."""
    zeros = {key: np.zeros((60 * 2**20, 1), dtype=np.int8), "more_scale": np.ones(1)}
    rng = np.random.Generator(np.random.Philox(3))
    ballast = rng.integers(0, 255, 2**21, dtype=np.uint8)  # or the archive would unpack too far
    np.savez_compressed(tmp_path / "bad.npz", **mano_files.arrays(), **zeros, ballast=ballast)
    with bounded(), pytest.raises(ModelError, match=rf"the largest, {key}, is"):
        load(tmp_path / "bad.npz")


def test_edge_a_mesh_that_cannot_be_closed(tmp_path: Path) -> None:
    content = mano_files.arrays()
    content["f"] = np.concatenate([content["f"], [[0, 10, 100]]])  # a third face on an edge
    np.savez(tmp_path / "bad.npz", **content)
    with pytest.raises(ModelError, match=r"bad\.npz: f: .*(edge-manifold|boundar)"):
        load(tmp_path / "bad.npz")


def test_edge_a_body_is_no_hand(tmp_path: Path) -> None:
    np.savez(tmp_path / "model.npz", **body_files.body("star"))
    with pytest.raises(ModelError, match="16 joints"):
        load_hand(tmp_path / "model.npz")


@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_edge_truncated(tmp_path: Path, suffix: str) -> None:
    whole = tmp_path / f"whole{suffix}"
    if suffix == ".npz":
        np.savez(whole, **mano_files.arrays())
    else:
        mano_files.write_pickle(whole, mano_files.arrays())
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
