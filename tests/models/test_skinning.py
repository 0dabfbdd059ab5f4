"""The skinning kernels against the plain sum, for every number of weights and samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from random_models import draw, model

from synthgen.models import skinning
from synthgen.models.arguments import checked
from synthgen.models.evaluation import driven, pose_skeleton
from synthgen.sampling.streams import stream

V, K = 37, 7


def given(n: int, k: int, dtype: Any) -> dict[str, Any]:
    rng = stream(0, "sample", n, k, "skinning")
    weights = -np.sort(-rng.random((V, k)), axis=1)
    weights[::3, 4:] = 0  # some have fewer than the table has room for
    weights[::5, 1:] = 0
    arrays = {
        "points": rng.normal(size=(n, 3 * V)), "maps": rng.normal(size=(n, K, 12)),
        "weights": weights, "excess": rng.normal(0, 0.01, V), "moved": rng.normal(size=(n, 3)),
    }  # fmt: skip
    ids = rng.integers(0, K, (V, k)).astype(np.int32)
    return {key: a.astype(dtype) for key, a in arrays.items()} | {"ids": ids}


def plain(
    points: Any, maps: Any, ids: Any, weights: Any, excess: Any, moved: Any
) -> Any:  # fmt: skip
    """v = p + e p + sum w (A - 1) p + t."""
    p = points.reshape(len(points), V, 3)
    rows = maps.reshape(len(maps), K, 3, 4)
    blended = np.einsum("vk,bvkij->bvij", weights, rows[:, ids])
    turned = np.einsum("bvij,bvj->bvi", blended[..., :3], p) + blended[..., 3]
    return (p + excess[:, None] * p + turned + moved[:, None]).reshape(points.shape)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("k", [4, 8, 12])
@pytest.mark.parametrize("n", [0, 1, 2, 5, 6])
def test_reference_plain_sum(n: int, k: int, dtype: Any) -> None:
    arrays = given(n, k, dtype)
    out = np.full_like(arrays["points"], np.nan)
    order = [arrays[key] for key in ("points", "maps", "ids", "weights", "excess", "moved")]
    skinning.skin(*order, out)
    wide = {key: a.astype(np.float64) for key, a in arrays.items() if key != "ids"}
    want = plain(**wide, ids=arrays["ids"])
    np.testing.assert_allclose(out, want, atol=1e-5 if dtype == np.float32 else 1e-13)
    skinning.skin(*order, order[0])
    np.testing.assert_array_equal(order[0], out)  # the result may take the points' place


@pytest.mark.parametrize("kind", ["smplh", "supr"])
@pytest.mark.parametrize("n", [1, 16, 21])
def test_reference_few_and_many_samples_are_corrected_alike(kind: str, n: int) -> None:
    made = model(kind, active=0.1)
    if kind == "smplh":
        made.posedirs[20:, :, 9 * 21 :] = 0
    packed = made.packed_double
    assert len(packed.runs.vertices)
    drawn = draw(made, n)
    arguments = checked(made, *drawn)
    drive = driven(packed, pose_skeleton(made, arguments, packed), arguments.translation)
    runs = packed.runs
    table = (drive.features, runs.vertices, runs.start, runs.feature, runs.offset, runs.values)
    few, many = np.ones((n, packed.basis.shape[1])), np.ones((n, packed.basis.shape[1]))
    skinning.correct_few(*table, few)
    skinning.correct_many(*table, many)
    assert np.abs(few - 1).max() > 1e-4
    np.testing.assert_allclose(many, few, atol=1e-12)
