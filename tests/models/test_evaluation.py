"""The kernels against the float64 reference, and what every family must obey."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from random_models import FAMILIES, Draw, draw, model

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.models import BodyModel, load

LIMIT_M = 2e-6


@pytest.fixture(scope="module", params=FAMILIES)
def made(request: pytest.FixtureRequest) -> BodyModel:
    return model(request.param)


def test_smoke_shapes_and_types(made: BodyModel) -> None:
    for n in (0, 1, 9):
        posed = made.evaluate(*draw(made, n))
        assert posed.vertices.shape == (n, len(made.v_template), 3)
        assert posed.joints.shape == (n, len(made.parents), 3)
        assert posed.vertices.dtype == posed.joints.dtype == np.float32


@pytest.mark.parametrize("n", [1, 7, 8, 16, 37, 70])
def test_reference_float64(made: BodyModel, n: int) -> None:
    """Few samples, whole and broken tiles, several chunks: all within the limit."""
    given = draw(made, n)
    vertices, joints = made.evaluate_reference(*given)
    posed = made.evaluate(*given)
    np.testing.assert_allclose(posed.vertices, vertices, atol=LIMIT_M, rtol=0)
    np.testing.assert_allclose(posed.joints, joints, atol=LIMIT_M, rtol=0)


def test_reference_large_angles(made: BodyModel) -> None:
    given = draw(made, 9, spread=2.5)
    vertices, _ = made.evaluate_reference(*given)
    np.testing.assert_allclose(made.evaluate(*given).vertices, vertices, atol=LIMIT_M, rtol=0)


def test_properties_batch_equals_loop(made: BodyModel) -> None:
    given = draw(made, 20)
    together = made.evaluate(*given).vertices
    alone = [made.evaluate(*given.rows(b)).vertices[0] for b in range(20)]
    np.testing.assert_allclose(together, alone, atol=1e-6, rtol=0)


@pytest.mark.parametrize("n", [1, 12])
def test_properties_zero_pose_is_the_shaped_template(made: BodyModel, n: int) -> None:
    given = draw(made, n)
    rest = np.zeros_like(given.pose)
    still = made.evaluate(np.zeros_like(given.shape), rest)
    exact = np.broadcast_to(made.v_template.astype(np.float32), still.vertices.shape)
    np.testing.assert_array_equal(still.vertices, exact)
    if made.family == "star":
        return  # its second beta drives a corrective too
    shaped = made.evaluate(given.shape, rest, None, given.expression).vertices
    for b in range(n):
        psi = None if given.expression is None else given.expression[b]
        want = made.shaped(given.shape[b], psi)[0]
        np.testing.assert_allclose(shaped[b], want, rtol=3e-7, atol=1e-7)


def test_properties_matrices_equal_axis_angle(made: BodyModel) -> None:
    if made.axis_meta is not None:
        pytest.skip("a constrained tree is driven by angles")
    given = draw(made, 10)
    turned = replace_pose(given, matrix_from_axis_angle(given.pose))
    a, b = made.evaluate(*given), made.evaluate(*turned)
    np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-6, rtol=0)


def test_properties_fewer_coefficients_are_filled_with_zeros(made: BodyModel) -> None:
    given = draw(made, 3)
    short = Draw(given.shape[:, :2], given.pose, None, None)
    filled = np.pad(given.shape[:, :2], ((0, 0), (0, made.n_shape - 2)))
    a, b = made.evaluate(*short), made.evaluate(filled, given.pose)
    np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-7, rtol=0)


def test_properties_joints_only(made: BodyModel) -> None:
    given = draw(made, 9)
    np.testing.assert_array_equal(made.evaluate_joints(*given), made.evaluate(*given).joints)


def test_properties_permuting_vertices_commutes(made: BodyModel) -> None:
    v = len(made.v_template)
    order = np.arange(v)[::-1]
    columns = order if made.family != "supr" else np.append(
        (3 * order[:, None] + np.arange(3)).ravel(), 3 * v)  # fmt: skip
    faces = None if made.exprdirs is None else made.exprdirs[order]
    shuffled = replace(
        made, v_template=made.v_template[order], shapedirs=made.shapedirs[order],
        posedirs=made.posedirs[order], weights=made.weights[order], exprdirs=faces,
        J_regressor=made.J_regressor[:, columns],
    )  # fmt: skip
    given = draw(made, 3)
    a, b = made.evaluate(*given), shuffled.evaluate(*given)
    np.testing.assert_allclose(a.vertices[:, order], b.vertices, atol=1e-6, rtol=0)


def test_properties_joint_basis_replaces_the_regressor(made: BodyModel) -> None:
    from synthgen.models.packed import fold_joints

    part = replace(made, joint_basis=fold_joints(made), J_regressor=np.zeros((0, 0)))
    given = draw(made, 2)
    a, b = made.evaluate_reference(*given), part.evaluate_reference(*given)
    np.testing.assert_allclose(b[0], a[0], atol=1e-12)
    np.testing.assert_allclose(b[1], a[1], atol=1e-12)
    np.testing.assert_allclose(part.evaluate(*given).vertices, a[0], atol=LIMIT_M, rtol=0)


@pytest.mark.parametrize("kind", ["smplh", "supr", "official"])
def test_edge_read_only_and_transposed_arrays(kind: str) -> None:
    """Arrays of a memory map, or of another layout, give the same numbers."""
    made = model(kind)
    given = draw(made, 2)
    arrays = {f.name: getattr(made, f.name) for f in fields(made)}
    odd = {n: np.asfortranarray(a) for n, a in arrays.items() if isinstance(a, np.ndarray)}
    for array in (*odd.values(), *(a for a in given if a is not None)):
        array.setflags(write=False)
    other = replace(made, **odd)
    a, b = other.evaluate(*given).vertices, made.evaluate(*given).vertices
    np.testing.assert_allclose(a, b, atol=1e-7, rtol=0)
    a, b = other.jacobian(*given).values, made.jacobian(*given).values
    np.testing.assert_allclose(a, b, atol=1e-12, rtol=0)


def test_edge_weights_that_do_not_sum_to_one() -> None:
    """Within a file's tolerance the official sum is kept, not renormalised."""
    made = model("mano")
    loose = replace(made, weights=made.weights * 1.0005)
    for n in (2, 9):
        given = draw(loose, n)
        want, _ = loose.evaluate_reference(*given)
        np.testing.assert_allclose(loose.evaluate(*given).vertices, want, atol=LIMIT_M, rtol=0)


def test_edge_more_than_four_weights_and_only_one() -> None:
    made = model("mano")
    assert (made.weights != 0).sum(axis=1).max() > 4
    rigid = replace(made, weights=np.eye(16)[made.weights.argmax(axis=1)])
    for n in (2, 9):
        given = draw(rigid, n)
        want, _ = rigid.evaluate_reference(*given)
        np.testing.assert_allclose(rigid.evaluate(*given).vertices, want, atol=LIMIT_M, rtol=0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shape": np.zeros((2, 7))}, r"\(2, 7\).*nb <= 6"),
        ({"shape": np.zeros((3, 6))}, "one row per pose"),
        ({"pose": np.zeros((2, 156))}, "flat_hand_mean"),
        ({"pose": np.zeros((2, 51, 3))}, r"\(B, 52, 3\)"),
        ({"pose": np.full((2, 52, 3), np.inf)}, "pose holds inf"),
        ({"pose": [[[0.0] * 3] * 52, [[0.0] * 3] * 51]}, "pose is no array of numbers"),
        ({"shape": [["a"], ["b"]]}, "shape is no array of numbers"),
        ({"pose": np.full((2, 52, 3), 1e200)}, "overflow"),
        ({"pose": np.tile(2 * np.eye(3), (2, 52, 1, 1))}, "no rotation"),
        ({"pose": np.tile(-np.eye(3), (2, 52, 1, 1))}, "no rotation"),
        ({"translation": np.zeros((2, 2))}, r"expected \(2, 3\)"),
        ({"translation": np.full((2, 3), np.nan)}, "translation holds nan"),
        ({"expression": np.zeros((2, 3))}, "no expression components"),
    ],
)  # fmt: skip
def test_edge_bad_arguments(change: dict[str, np.ndarray], words: str) -> None:
    made = model("smplh")
    given = {"shape": np.zeros((2, 6)), "pose": np.zeros((2, 52, 3)), **change}
    with pytest.raises(ShapeError, match=words):
        made.evaluate(**given)


def test_edge_constrained_pose_of_a_wrong_length() -> None:
    made = model("official")
    with pytest.raises(ShapeError, match=rf"\(B, {made.n_pose}\) angles"):
        made.evaluate(np.zeros((1, 6)), np.zeros((1, made.n_pose + 1)))


def test_properties_kernels_are_compiled_once() -> None:
    """Every kernel is cached on disk, so that a worker does not compile it again."""
    import synthgen.models

    folder = Path(synthgen.models.__file__).parent
    for path in folder.glob("*.py"):
        source = path.read_text(encoding="utf-8")
        assert source.count("@njit(") == source.count("@njit(cache=True"), path.name


def replace_pose(given: Draw, pose: np.ndarray) -> Draw:
    return Draw(given.shape, pose, given.translation, given.expression)


def test_edge_rest_pose_of_bad_coefficients() -> None:
    made = load("cc0-hand")
    vertices, joints = made.shaped(np.zeros(0))
    np.testing.assert_allclose(vertices, made.v_template)
    assert joints.shape == (16, 3)
    for bad, words in ((np.zeros(11), "n <= 10"), (np.zeros((1, 10)), r"\(1, 10\)"),
                       (np.full(3, np.nan), "finite")):  # fmt: skip
        with pytest.raises(ShapeError, match=words):
            made.shaped(bad)
    with pytest.raises(ShapeError, match="expression"):
        made.shaped(np.zeros(3), np.zeros(2))
