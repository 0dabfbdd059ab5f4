"""A body's skin and its rows against the float64 reference, finite differences and libigl."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from synthgen.errors import ModelError
from synthgen.geometry.normals import vertex_normals
from synthgen.registration.body_hands import hand_part
from synthgen.registration.body_kernels import normal_sums
from synthgen.registration.body_surface import BodySurface
from synthgen.registration.surface import surface_of
from tests.registration.bodies import NAMES, model, rng, surface, truth


def vector(s: BodySurface) -> np.ndarray:
    return rng("body vector").normal(0, 0.3, s.n)


def samples(s: BodySurface, n: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random points of the skin, half of them on hands, and directions."""
    random = rng("samples")
    hand = np.flatnonzero((s.model.weights.argmax(axis=1) >= 20)[s.faces].all(axis=1))
    faces = np.concatenate([random.integers(len(s.faces), size=n), random.choice(hand, n)])
    b = random.dirichlet([1, 1, 1], len(faces))
    return s.faces[faces], b, random.standard_normal((len(faces), 3))


def along(s: BodySurface, x: np.ndarray, points: tuple[np.ndarray, ...]) -> np.ndarray:
    t, b, d = points
    return np.asarray(np.einsum("mk,ma,mka->m", b, d, s.at(x).vertices[t]))


@pytest.mark.parametrize("name", NAMES)
def test_smoke_layout(name: str) -> None:
    s = surface(name)
    assert s.n == model(name).n_shape + 3 * s.n_joints + 3 + model(name).n_expression
    assert s.expression.stop == s.n
    assert s.at(vector(s)).rows(*samples(s)).shape == (120, s.n)


@pytest.mark.parametrize("name", NAMES)
def test_reference_vertices_and_joints(name: str) -> None:
    s, m = surface(name), model(name)
    x = vector(s)
    shape, pose, translation = s.unpack(x)
    expression = x[s.expression][None] if m.n_expression else None
    vertices, joints = m.evaluate_reference(shape[None], pose[None], translation[None], expression)
    np.testing.assert_allclose(s.at(x).vertices, vertices[0], atol=1e-12)
    np.testing.assert_allclose(s.at(x).joints, joints[0], atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_reference_rows_by_finite_differences(name: str) -> None:
    s, h = surface(name), 1e-6
    x, points = vector(s), samples(s)
    rows = s.at(x).rows(*points)
    for k in range(0, s.n, 5):
        step = np.zeros(s.n)
        step[k] = h
        slope = (along(s, x + step, points) - along(s, x - step, points)) / (2 * h)
        np.testing.assert_allclose(rows[:, k], slope, atol=2e-8)


@pytest.mark.parametrize("name", NAMES)
def test_reference_rows_against_the_whole_jacobian(name: str) -> None:
    """The model's own Jacobian keeps correctives in single precision: equal to 1e-7."""
    s = surface(name)
    placed, (t, b, d) = s.at(vector(s)), samples(s)
    whole = np.einsum("mk,ma,mkan->mn", b, d, placed.jacobian[t])
    np.testing.assert_allclose(placed.rows(t, b, d), whole, atol=1e-7)
    some = np.array([5, 700, 9000])
    rows = np.einsum("ma,man->mn", d[:3], placed.jacobian[some])
    np.testing.assert_allclose(placed.vertex_rows(some, d[:3]), rows, atol=1e-7)
    np.testing.assert_allclose(placed.joint_jacobian, placed._slopes.joint_values, atol=1e-12)


def test_reference_rows_of_dense_correctives() -> None:
    """A hand's part has correctives on most vertices, as published bodies have."""
    part = hand_part(surface(), "left").surface
    assert len(part.model.packed_double.dense) > 0
    x, h = rng("part").normal(0, 0.3, part.n), 1e-6
    random = rng("part samples")
    t = part.faces[random.integers(len(part.faces), size=40)]
    points = (t, random.dirichlet([1, 1, 1], 40), random.standard_normal((40, 3)))
    rows = part.at(x).rows(*points)
    for k in range(part.n):
        step = np.zeros(part.n)
        step[k] = h
        slope = (along(part, x + step, points) - along(part, x - step, points)) / (2 * h)
        np.testing.assert_allclose(rows[:, k], slope, atol=2e-8)


def test_reference_hand_part_is_the_body_there() -> None:
    part, x = hand_part(surface(), "right"), truth()
    small = part.surface.at(x[part.columns]).vertices
    own = surface().at(x)
    distance, _ = own.tree.query(small)
    assert distance.max() < 1e-9


def test_reference_normals() -> None:
    placed = surface().at(vector(surface()))
    other = vertex_normals(placed.vertices, surface().faces)
    np.testing.assert_allclose(placed.normals, other, atol=1e-9)


def test_reference_closest_points_against_libigl() -> None:
    """Four neighbours are exact for all but a few points, one for all but a few per cent."""
    import igl

    placed, random = surface().at(truth()), rng("closest")
    points = placed.vertices[random.integers(13_380, size=3000)] + random.normal(0, 3e-3, (3000, 3))
    exact = igl.point_mesh_squared_distance(points, placed.vertices, surface().faces)[0]
    for neighbours, share in ((1, 0.06), (4, 0.005)):
        squared, face, at = placed.nearest(points, neighbours)
        off = np.sqrt(squared) - np.sqrt(exact)
        assert off.min() > -1e-9
        assert (off > 1e-6).mean() < share
        np.testing.assert_allclose(np.sum((points - at) ** 2, axis=1), squared, atol=1e-12)
        low = placed.vertices[surface().faces[face]].min(axis=1) - 1e-9
        assert np.all(at >= low)


def test_reference_sums_of_sparse_rows() -> None:
    random = rng("sums")
    rows = random.standard_normal((50, 30)) * (random.random((50, 30)) < 0.3)
    w, r = random.random(50), random.standard_normal(50)
    hessian, gradient = np.zeros((30, 30)), np.zeros(30)
    normal_sums(rows, w, r, hessian, gradient)
    whole = rows.T @ (w[:, None] * rows)
    np.testing.assert_allclose(hessian, np.tril(whole), atol=1e-12)
    np.testing.assert_allclose(gradient, rows.T @ (w * r), atol=1e-12)


def test_properties_one_surface_a_model() -> None:
    assert surface_of(model()) is surface_of(model())
    assert isinstance(surface_of(model()), BodySurface)


def test_edge_other_families_are_refused() -> None:
    with pytest.raises(ModelError, match="star"):
        BodySurface(replace(model(), family="star"))
