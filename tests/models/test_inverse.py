"""Inverse helpers: what went in comes out again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import body_files
import numpy as np
import pytest

from synthgen.errors import ModelError, ShapeError
from synthgen.models import (
    BodyModel,
    fit_vertices,
    load,
    load_hand,
    map_pose,
    pca_from_pose,
    pose_from_pca,
)
from synthgen.sampling.streams import stream


def rng(name: str) -> np.random.Generator:
    return stream(0, "sample", 0, 0, name)


def body(folder: Path, family: str = "smplh") -> BodyModel:
    content = body_files.body(family, pairs=400, betas=6)
    content |= body_files.hands() if family == "smplh" else {}
    np.savez(folder / "body.npz", **content)
    return load(folder / "body.npz")


@pytest.mark.parametrize("flat", [True, False])
def test_reference_pca_round_trip(flat: bool) -> None:
    model = load_hand("cc0-hand")
    wanted = rng("pca").normal(size=(4, 45))
    pose = pose_from_pca(model, np.zeros((4, 1, 3)), wanted, flat_hand_mean=flat)
    found, residual = pca_from_pose(model, pose, flat_hand_mean=flat)
    np.testing.assert_allclose(found, wanted, atol=1e-10)
    assert residual.max() < 1e-12


def test_properties_pca_of_components_that_are_not_orthonormal() -> None:
    """Published components are not: the transpose would miss, least squares does not."""
    hand = load_hand("cc0-hand")
    bent = hand.hands_components + 0.02 * rng("bent").normal(size=(45, 45))
    model = replace(hand, hands_components=bent)
    wanted = rng("pca").normal(size=(2, 6))
    pose = wanted @ bent[:6]
    found, residual = pca_from_pose(model, pose, flat_hand_mean=True, n=6)
    np.testing.assert_allclose(found, wanted, atol=1e-10)
    assert np.abs(pose @ bent[:6].T - wanted).max() > 1e-3
    assert residual.max() < 1e-10


def test_properties_residual_is_what_the_components_lack() -> None:
    model = load_hand("cc0-hand")
    pose = rng("rest").normal(0, 0.3, (3, 16, 3))
    last = np.inf
    for n in (6, 15, 45):
        _, residual = pca_from_pose(model, pose, flat_hand_mean=False, n=n)
        assert (residual < last).all()
        last = residual
    assert residual.max() < 1e-10


def test_properties_pca_of_one_hand_of_a_body(tmp_path: Path) -> None:
    model = body(tmp_path)
    left, right = rng("two").normal(size=(2, 3, 6))
    pose = pose_from_pca(model, np.zeros((3, 22, 3)), left, right, flat_hand_mean=False)
    for side, wanted in (("left", left), ("right", right)):
        found, _ = pca_from_pose(model, pose, flat_hand_mean=False, n=6, hand=side)
        np.testing.assert_allclose(found, wanted, atol=1e-10)


@pytest.mark.parametrize("hand", ["right", "left"])
def test_reference_vertices_of_a_hand(hand: str) -> None:
    model = load_hand("cc0-hand", hand=hand)
    draw = rng("fit")
    shape, move = draw.normal(size=10), draw.normal(size=3)
    pose = draw.normal(0, 0.5, (16, 3))
    pose[0] = [2.0, -1.5, 0.8]
    points, _ = model.evaluate_reference(shape[None], pose[None], move[None])
    fit = fit_vertices(model, points[0])
    assert fit.converged
    assert fit.worst_m < 1e-6
    np.testing.assert_allclose(fit.shape, shape, atol=1e-3)
    found, _ = model.evaluate_reference(fit.shape[None], fit.pose[None], fit.translation[None])
    np.testing.assert_allclose(found, points, atol=1e-6)


@pytest.mark.parametrize("family", ["smplh", "star", "supr"])
def test_reference_vertices_of_bodies(family: str, tmp_path: Path) -> None:
    model = body(tmp_path, family)
    draw = rng("fit body")
    shape, pose = draw.normal(size=6), draw.normal(0, 0.25, (len(model.parents), 3))
    points, _ = model.evaluate_reference(shape[None], pose[None], np.ones((1, 3)))
    fit = fit_vertices(model, points[0])
    assert fit.worst_m < 1e-5


def test_properties_some_points_and_weights() -> None:
    """A weightless outlier changes nothing; half of the vertices are enough."""
    model = load_hand("cc0-hand")
    draw = rng("some")
    pose = draw.normal(0, 0.3, (16, 3))
    points = model.evaluate_reference(np.zeros((1, 10)), pose[None])[0][0]
    ids = np.sort(draw.permutation(len(points))[: len(points) // 2])
    chosen, weights = points[ids], np.ones(len(ids))
    chosen[7] += 0.3
    weights[7] = 0
    fit = fit_vertices(model, chosen, ids, weights=weights, n_shape=4)
    found = model.evaluate_reference(fit.shape[None], fit.pose[None], fit.translation[None])[0][0]
    np.testing.assert_allclose(found, points, atol=1e-5)
    assert fit.worst_m > 0.29


def test_properties_noise_is_averaged() -> None:
    model = load_hand("cc0-hand")
    draw = rng("noise")
    pose = draw.normal(0, 0.3, (16, 3))
    points = model.evaluate_reference(np.zeros((1, 10)), pose[None])[0][0]
    fit = fit_vertices(model, points + draw.normal(0, 1e-3, points.shape))
    found = model.evaluate_reference(fit.shape[None], fit.pose[None], fit.translation[None])[0][0]
    assert np.sqrt(np.mean((found - points) ** 2)) < 3e-4


def test_reference_pose_maps_by_name(tmp_path: Path) -> None:
    pose = rng("map").normal(0, 0.3, (2, 52, 3))
    there = map_pose(pose, "smplh", "supr")
    assert there.pose.shape == (2, 75, 3)
    assert "jaw" in there.at_rest
    assert not there.lost
    back = map_pose(there.pose, "supr", body(tmp_path))
    np.testing.assert_array_equal(back.pose, pose)
    assert len(back.lost) == 23
    assert max(back.lost.values()) == 0
    turned = there.pose.copy()
    turned[1, 22] = [0.5, 0, 0]
    assert map_pose(turned, "supr", "smplh").lost["jaw"] == pytest.approx(0.5)


def test_edge_inverse_arguments(tmp_path: Path) -> None:
    hand = load_hand("cc0-hand")
    with pytest.raises(ShapeError, match="1 to 45"):
        pca_from_pose(hand, np.zeros((1, 45)), flat_hand_mean=True, n=46)
    with pytest.raises(ModelError, match="pose space"):
        pca_from_pose(body(tmp_path, "star"), np.zeros((1, 45)), flat_hand_mean=True, hand="left")
    with pytest.raises(ShapeError, match="one vertex"):
        fit_vertices(hand, np.zeros((5, 3)))
    with pytest.raises(ShapeError, match="NaN"):
        fit_vertices(hand, np.full((4, 3), np.nan), np.arange(4))
    with pytest.raises(ShapeError, match=r"n_shape=-1.*negative"):
        fit_vertices(hand, hand.v_template, n_shape=-1)
    with pytest.raises(ModelError, match="known are smplh"):
        map_pose(np.zeros((52, 3)), "smpl", "supr")
    with pytest.raises(ShapeError, match="52, 3"):
        map_pose(np.zeros((51, 3)), "smplh", "supr")
