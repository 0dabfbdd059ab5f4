"""The steps of the bodies' building, one by one, without MakeHuman's data."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from synthgen.cc0.body_correctives import learn_activations, learn_ridge, mirror_blocks
from synthgen.cc0.body_poses import known_poses, mixed_turns, pose_range, single_turns
from synthgen.cc0.bodyskin import four_per_vertex
from synthgen.cc0.contact import Foot, right_foot, simulate
from synthgen.cc0.feet import measure
from synthgen.cc0.garment import sliced
from synthgen.cc0.packing import (
    packed_correctives,
    packed_expressions,
    packed_regressor,
    packed_weights,
    quantised,
)
from synthgen.cc0.skeleton import SMPLH52, SUPR75, bone_transforms, joint_of_bones
from synthgen.geometry.normals import face_cross
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import compact, load
from synthgen.models.foot import feet_of
from synthgen.sampling.streams import stream


def rng_of(name: str) -> np.random.Generator:
    return stream(11, "sample", 0, 0, f"building/{name}")


@pytest.mark.parametrize("skeleton", [SMPLH52, SUPR75])
def test_shape_skeletons(skeleton: Any) -> None:
    mirrored = skeleton.mirrored
    assert np.array_equal(mirrored[mirrored], np.arange(len(skeleton.names)))
    assert all(p < k for k, p in enumerate(skeleton.parents))
    assert skeleton.nearest("left_eye") == skeleton.index(
        "left_eye" if len(skeleton.names) == 75 else "head"
    )


def test_properties_bones_follow_their_parents_joint() -> None:
    parents = {"root": "", "wrist.R": "root", "metacarpal1.R": "wrist.R", "head": "root",
               "jaw": "head", "special04": "jaw", "oris01": "oris02", "oris02": "special04",
               "toe3-3.L": "toe3-2.L", "toe3-2.L": "root", "finger2-1.L": "root"}  # fmt: skip
    joints = joint_of_bones(parents)
    assert joints["metacarpal1.R"] == "right_wrist"
    assert joints["oris01"] == "jaw"
    assert joints["toe3-3.L"] == "left_middletoe2"
    assert joints["finger2-1.L"] == "left_index1"


def test_properties_forearm_shares_the_hands_twist() -> None:
    """Bones of the forearm turn by part of the wrist's twist, all else by their joint's turn."""
    joints = np.zeros((52, 3))
    joints[SMPLH52.index("right_wrist")] = [-0.3, 0, 0]
    pose = np.zeros((1, 52, 3))
    pose[0, SMPLH52.index("right_wrist"), 0] = 1.0
    owner = np.array([SMPLH52.index("right_elbow")] * 2 + [SMPLH52.index("right_wrist")])
    maps = bone_transforms(
        SMPLH52, ("lowerarm01.R", "lowerarm02.R", "wrist.R"), owner, matrix_from_axis_angle(pose),
        joints,
    )  # fmt: skip
    angles = np.arctan2(maps[0, :, 2, 1], maps[0, :, 1, 1])
    assert 0 < angles[0] < angles[1] < angles[2]
    np.testing.assert_allclose(angles[2], 1.0)


def test_properties_poses_keep_their_ranges_and_sides() -> None:
    ranges = pose_range(SUPR75)
    assert np.all(ranges[..., 0] <= ranges[..., 1])
    flipped = ranges[SUPR75.mirrored] * np.array([1, -1, -1])[:, None]
    np.testing.assert_allclose(np.sort(flipped, axis=2), ranges)
    assert np.all((single_turns(SUPR75) != 0).any(axis=2).sum(axis=1) == 1)
    drawn = mixed_turns(SUPR75, 12, rng=rng_of("poses"))
    assert drawn.shape == (12, 75, 3)
    assert np.array_equal(drawn, mixed_turns(SUPR75, 12, rng=rng_of("poses")))
    assert np.all(drawn[:, [SUPR75.index("left_index1"), 0]] == 0)
    names, poses = known_poses(SMPLH52)
    assert len(names) == len(poses)


def test_properties_four_per_vertex() -> None:
    weights = rng_of("weights").random((50, 9))
    kept = four_per_vertex(weights)
    np.testing.assert_allclose(kept.sum(axis=1), 1)
    assert ((kept > 0).sum(axis=1) == 4).all()
    order = rng_of("order").permutation(9)
    np.testing.assert_allclose(four_per_vertex(weights[:, order]), kept[:, order])


def made_up(b: int) -> tuple[Any, Any, Any, Any]:
    """Features, offsets that joints 1 and 3 of each vertex make, and who is relevant."""
    rng = rng_of("correctives")
    feature = rng.normal(size=(60, 5, b))
    truth = np.zeros((20, 5, 3, b))
    truth[:10, 1], truth[10:, 3] = rng.normal(size=(2, 10, 3, b)) * 0.01
    relevant = np.zeros((20, 5), dtype=bool)
    relevant[:, [1, 2]] = True
    relevant[10:, 3] = True
    return feature, np.einsum("nkb,vkcb->nvc", feature, truth), truth, relevant


def test_properties_ridge_finds_what_is_there() -> None:
    feature, offsets, truth, relevant = made_up(9)
    found = learn_ridge(feature, offsets, relevant, np.zeros((20, 5)))
    np.testing.assert_allclose(found, truth, atol=1e-6)
    dear = learn_ridge(feature, offsets, relevant, np.full((20, 5), 20.0))
    assert np.abs(dear).sum() < 0.4 * np.abs(truth).sum()  # Eq. 10: far joints are dear
    assert np.all(dear[~relevant] == 0)


def test_properties_activations_vanish_exactly() -> None:
    feature, offsets, truth, relevant = made_up(4)
    found, active = learn_activations(feature, offsets, relevant)
    assert np.array_equal(active > 0, truth.any(axis=(2, 3)))
    assert np.all(found[active == 0] == 0)
    np.testing.assert_allclose(found, truth, atol=2e-4)


@pytest.mark.parametrize("b", [4, 9])
def test_properties_mirrored_blocks(b: int) -> None:
    """Mirroring what was mirrored gives it back; vertices on the midline are symmetric."""
    half = rng_of("mirror").normal(size=(3, 2, 3, b))
    mirror, joints = np.array([4, 1, 3, 2, 0]), np.array([1, 0])
    both = mirror_blocks(half, np.array([0, 1, 2]), mirror, joints)
    again = mirror_blocks(both[[4, 1, 3]], np.array([4, 1, 3]), mirror, joints)
    np.testing.assert_allclose(again, both)
    np.testing.assert_allclose(both[0], half[0])


def test_reference_packing_round_trip() -> None:
    rng = rng_of("packing")
    k, v = 5, 40
    weights = four_per_vertex(rng.random((v, k)))
    regressor = np.where(rng.random((k, v)) < 0.2, rng.random((k, v)), 0)
    blocks = rng.normal(size=(v, k, 3, 4)) * 1e-3
    blocks[rng.random((v, k)) < 0.5] = 0
    bases = rng.normal(size=(v, 3, 6)) * [1, 0.1, 0.01, 1e-3, 1e-4, 0]
    face = np.zeros((v, 3, 2))
    face[3:7] = 0.01
    arrays = {
        "shipped_form": np.array("supr"), "v_template": np.zeros((v, 3)),
        "kintree_table": np.zeros((2, k), dtype=np.int64), "f": np.zeros((1, 3)),
        "hands_mean": np.zeros(45), "hands_components": np.eye(45),
        "hands_coeffs": np.zeros((2, 45)), **quantised("shapedirs", bases),
        **packed_weights(weights), **packed_regressor(regressor),
        **packed_correctives(blocks, np.abs(blocks).max(axis=(2, 3))),
        **packed_expressions("exprdirs", face),
    }  # fmt: skip
    found = compact.expand(arrays)
    off = np.abs(found["shapedirs"] - bases).max(axis=(0, 1))
    assert np.all(off <= 0.501 * np.abs(bases).max(axis=(0, 1)) / 32767 + 1e-12)
    np.testing.assert_allclose(found["weights"], weights, atol=1e-7)
    np.testing.assert_allclose(found["exprdirs"], face, atol=1e-6)
    np.testing.assert_allclose(found["posedirs"].reshape(v, 3, k, 4).transpose(0, 2, 1, 3), blocks,
                               atol=1e-6)  # fmt: skip
    plain = np.kron(regressor, np.eye(3))
    np.testing.assert_allclose(found["J_regressor"][:, :-1], plain, atol=1e-7)
    assert np.array_equal(found["activations"].T > 0, blocks.any(axis=(2, 3)))


def test_properties_slicing_keeps_the_area() -> None:
    rng = rng_of("slices")
    x, y = np.meshgrid(np.arange(8.0), np.arange(8.0))
    points = np.stack([x.ravel(), y.ravel(), 0.1 * rng.random(64)], axis=1)
    corner = (np.arange(64).reshape(8, 8)[:-1, :-1]).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + 9], 1),
            np.stack([corner, corner + 9, corner + 8], 1),
        ]
    )
    field = points @ [0.5, 0.8, 0.0] - 4.3
    grown, low, high = sliced(points, faces, field)
    area = [0.5 * np.linalg.norm(face_cross(grown, f), axis=1).sum() for f in (low, high)]
    whole = 0.5 * np.linalg.norm(face_cross(points, faces), axis=1).sum()
    assert sum(area) == pytest.approx(whole)
    level = grown @ [0.5, 0.8, 0.0] - 4.3
    assert level[low].max() < 2e-3 and level[high].min() > -2e-3


@pytest.fixture(scope="module")
def foot() -> Foot:
    """The foot that the network was trained on, from the shipped body."""
    body = load("cc0-supr")
    base = SimpleNamespace(
        cut=SimpleNamespace(n_body=len(body.v_template), faces=body.faces),
        template=body.v_template, skeleton=SUPR75, weights=body.weights, shapes=body.shapedirs,
        regressor=body.J_regressor[::3, :-1:3], joints=body.shaped(np.zeros(1))[1],
    )  # fmt: skip
    return right_foot(base, body.part_ids["right_foot"])  # type: ignore[arg-type]


def test_properties_simulated_contact(foot: Foot) -> None:
    feature, offsets = simulate(foot, 40, rng=rng_of("contact"))
    contact = feature[:, -266:] > 0
    touched = contact.any(axis=1)
    assert 0.5 < touched.mean() < 0.95
    assert np.all(offsets[~touched] == 0)
    assert np.all(np.abs(offsets[touched]).max(axis=(1, 2)) > 1e-4)
    assert np.abs(offsets).max() < 0.02
    assert contact[touched].sum(axis=1).mean() > 8
    again = simulate(foot, 40, rng=rng_of("contact"))
    assert np.array_equal(again[1], offsets)


def test_reference_network_on_feet_it_never_saw(foot: Foot) -> None:
    """The shipped network halves the distance to simulated feet, and leaves others alone."""
    network = feet_of(load("cc0-supr"))[1]
    said = measure(network, *simulate(foot, 150, rng=rng_of("unseen feet")))
    assert said["cut"] > 0.5
    assert said["not_touching_mm"] == 0
