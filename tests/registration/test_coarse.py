"""The thinned batch model against the full one, and the coarse rounds."""

from __future__ import annotations

from typing import Any

import numpy as np

from synthgen.registration import coarse
from synthgen.registration.coarse_model import CoarseModel, Starts, coarse_model_of, join, spread
from synthgen.registration.initialiser import initialiser_of, load_initialiser, rotation_from_6d
from synthgen.registration.prior import HandPrior, learned_prior
from synthgen.registration.starts import (
    around,
    learned_starts,
    reseeded,
    spread_rotations,
    table_starts,
)
from tests.registration.hands import error_mm, model, perturbed, rng, scan, surface, truth


def prior() -> HandPrior:
    net = initialiser_of(model())
    assert net is not None
    return net.prior


def thin() -> CoarseModel:
    return coarse_model_of(model(), prior())


def some_starts(n: int = 2) -> Starts:
    random = rng("starts")
    return Starts(
        spread_rotations(n),
        np.zeros((n, 3), np.float32),
        random.normal(0, 0.7, (n, 30)).astype(np.float32),
        random.normal(0, 1, (n, 10)).astype(np.float32),
    )


def scan_points(n: int = 600) -> tuple[Any, Any]:
    return scan().points[:n].astype(np.float32), scan().normals[:n].astype(np.float32)


def test_reference_full_model_without_correctives() -> None:
    from dataclasses import replace

    starts = some_starts()
    plain = replace(model(), posedirs=np.zeros_like(model().posedirs))
    x = thin().to_vectors(starts)
    shape, pose, translation = zip(*(surface().unpack(row) for row in x), strict=True)
    posed = plain.evaluate(np.array(shape), np.array(pose), np.array(translation))
    placed = thin().place(starts)
    np.testing.assert_allclose(placed.vertices, posed.vertices[:, thin().ids], atol=2e-6)


def test_reference_jacobian_by_finite_differences() -> None:
    starts, h = some_starts(), 1e-2
    jacobian = thin().jacobian(thin().place(starts))
    for k in (0, 3, 4, 5, 6, 20, 36, 45):
        move = np.zeros((2, thin().n))
        move[:, k] = h
        ahead = thin().place(coarse._moved(starts, move)).vertices
        behind = thin().place(coarse._moved(starts, -move)).vertices
        np.testing.assert_allclose(jacobian[..., k], (ahead - behind) / (2 * h), atol=2e-5)


def test_reference_rigid_jacobian_is_part_of_the_whole() -> None:
    placed = thin().place(some_starts())
    whole = thin().jacobian(placed)[..., [*range(6), 36]]
    np.testing.assert_allclose(thin().rigid_jacobian(placed), whole, atol=1e-6)


def test_reference_nearest_pairs_by_brute_force() -> None:
    placed, (points, normals) = thin().place(some_starts(3)), scan_points(50)
    vertex, point = coarse.pairs_of(placed.vertices, placed.normals, points, normals)
    own = np.concatenate([placed.vertices, coarse.NORMAL_M * placed.normals], axis=-1)
    other = np.concatenate([points, coarse.NORMAL_M * normals], axis=-1)
    apart = np.linalg.norm(own[:, None] - other[:, None], axis=-1)
    near = np.take_along_axis(apart, vertex[..., None], axis=2)[..., 0]
    np.testing.assert_allclose(near, apart.min(axis=2), atol=1e-6)
    near = np.take_along_axis(apart, point[:, None], axis=1)[:, 0]
    np.testing.assert_allclose(near, apart.min(axis=1), atol=1e-6)


def test_properties_vectors_and_back() -> None:
    starts = some_starts()
    again = thin().from_vectors(thin().to_vectors(starts))
    np.testing.assert_allclose(again.rotation, starts.rotation, atol=1e-5)
    np.testing.assert_allclose(again.coefficients, starts.coefficients, atol=1e-4)


def test_properties_rounds_find_the_hand() -> None:
    points, normals = scan_points()
    x = surface().pack(*perturbed())
    starts = around(thin(), x, scan().centre)
    found, energy = coarse.run(thin(), starts, points, normals, coarse.COLD)
    assert np.all(np.diff(energy) >= 0)
    best = surface().at(thin().to_vectors(found)[0]).vertices
    assert error_mm(best) < 8


def test_properties_distinct_starts_are_apart() -> None:
    vertices = np.zeros((3, 5, 3), np.float32)
    vertices[2] += 0.01
    order = coarse.distinct(vertices, np.array([0.2, 0.1, 0.3], np.float32), 3, 0.001)
    assert order.tolist() == [1, 2]


def test_smoke_initialiser_is_shipped_and_small() -> None:
    net = initialiser_of(model())
    assert net is not None
    assert net.digest == model().digest
    assert 300_000 < net.n_weights < 500_000


def test_properties_network_does_not_depend_on_the_order_of_points() -> None:
    net = initialiser_of(model())
    assert net is not None
    x = rng("cloud").standard_normal((2, 128, 6)).astype(np.float32)
    mixed = x[:, rng("order").permutation(128)]
    np.testing.assert_allclose(net.forward(x), net.forward(mixed), atol=2e-4)


def test_properties_network_starts_near_the_hand() -> None:
    net = initialiser_of(model())
    assert net is not None
    points, normals = scan_points()
    starts = learned_starts(net, thin(), points, normals, 4)
    assert len(starts) == 16
    errors = [error_mm(surface().at(x).vertices) for x in thin().to_vectors(starts)]
    assert min(errors) < 35


def test_properties_table_needs_no_weights() -> None:
    points, normals = scan_points()
    starts = table_starts(thin(), points, normals, scan().centre)
    found, _ = coarse.run(thin(), starts, points, normals, coarse.COLD)
    errors = [error_mm(surface().at(x).vertices) for x in thin().to_vectors(found)]
    assert min(errors) < 15


def test_properties_reseeding_changes_one_finger_at_a_time() -> None:
    starts = reseeded(thin(), truth(), prior().fingers)
    assert len(starts) == 40
    np.testing.assert_allclose(starts.translation, starts.translation[:1].repeat(40, 0))
    assert len(join([starts, starts])) == 80


def test_properties_spread_rotations_cover() -> None:
    turns = spread_rotations(288).astype(np.float64)
    np.testing.assert_allclose(np.linalg.det(turns), 1, atol=1e-5)
    some = spread_rotations(50)[::7].transpose(0, 2, 1)
    trace = np.einsum("sab,tba->st", some, turns)
    angle = np.rad2deg(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
    assert angle.min(axis=1).max() < 35


def test_reference_six_numbers_of_zero_are_the_identity() -> None:
    np.testing.assert_allclose(rotation_from_6d(np.zeros((1, 6), np.float32))[0], np.eye(3))


def test_properties_spread_points_are_apart() -> None:
    points = rng("points").random((200, 3))
    ids = spread(points, 20)
    assert len(set(ids.tolist())) == 20


def test_edge_no_initialiser(tmp_path: Any) -> None:
    import pytest

    from synthgen.errors import ModelError

    file = tmp_path / "x.npz"
    np.savez(file, a=np.zeros(3))
    with pytest.raises(ModelError, match="train-init"):
        load_initialiser(file)


def test_reference_prior_is_learned_from_the_samplers() -> None:
    found = learned_prior(model())
    assert found.means.shape == (10, 45)
    assert found.fingers.shape == (5, 8, 9)
    assert found.constants.min() == 0
    shipped = prior()
    np.testing.assert_allclose(found.mean, shipped.mean, atol=1e-5)
