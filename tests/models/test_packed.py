"""What the kernels read: zeros left out, joints folded, weights in order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_models import FAMILIES, draw, model

from synthgen.models import BodyModel, load_hand
from synthgen.models.packed import SPARSE_SHARE, fold_joints, largest_weights, pack


@pytest.fixture(scope="module", params=FAMILIES)
def made(request: pytest.FixtureRequest) -> BodyModel:
    return model(request.param)


def test_reference_folded_joints(made: BodyModel) -> None:
    given, basis = draw(made, 1).one(0), fold_joints(made)
    psi = np.zeros(0) if given.expression is None else given.expression
    folded = np.tensordot(np.concatenate([[1.0], given.shape, psi]), basis, 1)
    joints = made.shaped(given.shape, given.expression)[1]
    np.testing.assert_allclose(folded, joints, atol=1e-13)


def test_reference_every_corrective_is_kept(made: BodyModel) -> None:
    """Dense rows and sparse runs together hold exactly the nonzero correctives."""
    packed, q = pack(made, np.float64), 9 if made.family in ("mano", "smplh") else 4
    k, v = len(made.parents), len(made.v_template)
    whole = np.zeros((k * q, v, 3))
    whole[packed.dense] = packed.basis[: len(packed.dense)].reshape(-1, v, 3)
    runs = packed.runs
    for vertex in range(v):
        for n in range(runs.start[vertex], runs.start[vertex + 1]):
            rows = runs.values[runs.offset[n] : runs.offset[n + 1]].reshape(3, -1)
            at = runs.feature[n]
            whole[at : at + rows.shape[1], vertex] = rows.T
    columns = made.posedirs[..., :-1] if made.family == "star" else made.posedirs
    first = k * q - columns.shape[2]
    np.testing.assert_array_equal(whole[first:], columns.transpose(2, 0, 1))
    assert not whole[:first].any()


def test_properties_hand_local_correctives_are_not_read() -> None:
    """Section 3.4: fingers correct the hands only; half of the bytes are zeros."""
    made = model("smplh", pairs=100)
    inside = np.zeros(len(made.v_template), dtype=bool)
    inside[10:40] = True
    posedirs = made.posedirs.copy()
    posedirs[~inside, :, 9 * 21 :] = 0
    local = replace(made, posedirs=posedirs)
    assert len(local.packed.dense) == 9 * 21
    assert local.packed.nbytes < 0.6 * made.packed.nbytes
    # one run of the 30 finger joints for each vertex of the hands
    np.testing.assert_array_equal(np.diff(local.packed.runs.start), inside)
    for n in (2, 20):
        given = draw(local, n)
        want, _ = local.evaluate_reference(*given)
        np.testing.assert_allclose(local.evaluate(*given).vertices, want, atol=2e-6, rtol=0)


def test_properties_sparse_only_where_it_pays() -> None:
    supr = model("supr", active=SPARSE_SHARE / 2)
    assert len(supr.packed.dense) == 0
    assert len(model("smplh").packed.runs.values) == 0
    assert len(load_hand("cc0-hand").packed.basis) > 11


def test_properties_weights() -> None:
    rows = np.array([[0.2, 0, 0.5, 0.3, 0], [0, 1.0, 0, 0, 0]])
    ids, weights = largest_weights(rows)
    np.testing.assert_array_equal(ids[0], [2, 3, 0])
    np.testing.assert_array_equal(weights, [[0.5, 0.3, 0.2], [1.0, 0, 0]])
    packed = model("mano").packed
    assert packed.weights.shape[1] % 4 == 0
    assert np.all(np.diff(packed.weights, axis=1) <= 0)
    assert not packed.excess.any()
