"""The torch layer: torch's own gradient check, and clear refusals."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from random_models import FAMILIES, Draw, draw, model

import synthgen
from synthgen.errors import ShapeError
from synthgen.models import BodyModel


@pytest.fixture(scope="module", params=FAMILIES)
def made(request: pytest.FixtureRequest) -> BodyModel:
    return model(request.param, pairs=4, betas=3)


def tensors(given: Draw, dtype: torch.dtype = torch.float64) -> list[torch.Tensor]:
    present = [a for a in given if a is not None]
    return [torch.tensor(a, dtype=dtype, requires_grad=True) for a in present]


def test_smoke_twice_from_the_package() -> None:
    for _ in range(2):
        layer = synthgen.models.as_torch(model("mano"))
        assert isinstance(layer, torch.nn.Module)


def test_reference_forward(made: BodyModel) -> None:
    given = draw(made, 3)
    layer = synthgen.models.as_torch(made)
    vertices, joints = layer(*tensors(given, torch.float32))
    posed = made.evaluate(*given)
    assert vertices.dtype == joints.dtype == torch.float32
    np.testing.assert_allclose(vertices.detach(), posed.vertices, atol=1e-6)
    np.testing.assert_allclose(joints.detach(), posed.joints, atol=1e-6)


def test_properties_gradcheck(made: BodyModel) -> None:
    """Sample 1 has the zero pose."""
    layer = synthgen.models.as_torch(made)
    assert torch.autograd.gradcheck(lambda *a: tuple(layer(*a)), tensors(draw(made, 2)))


def test_properties_a_fit_descends() -> None:
    made = model("mano")
    layer, given = synthgen.models.as_torch(made), draw(made, 1, spread=0.3)
    target = torch.tensor(made.evaluate(*given).vertices)
    pose = torch.zeros(1, 16, 3, requires_grad=True)
    move = torch.tensor(given.translation, dtype=torch.float32)
    beta = torch.tensor(given.shape, dtype=torch.float32)
    optimiser = torch.optim.LBFGS([pose], max_iter=60)

    def loss() -> torch.Tensor:
        optimiser.zero_grad()
        value = (layer(beta, pose, move).vertices - target).square().sum()
        value.backward()
        return value

    first = loss().item()
    optimiser.step(loss)
    assert loss().item() < 1e-3 * first


def test_edge_second_differentiation_is_refused() -> None:
    made = model("mano", pairs=4)
    inputs = tensors(draw(made, 1))
    posed = synthgen.models.as_torch(made)(*inputs)
    (slope,) = torch.autograd.grad(posed.vertices.square().sum(), inputs[1], create_graph=True)
    with pytest.raises(RuntimeError, match="twice"):
        slope.sum().backward()


def test_edge_matrices_and_other_types() -> None:
    layer = synthgen.models.as_torch(model("mano"))
    with pytest.raises(ShapeError, match="keeps it a rotation"):
        layer(torch.zeros(1, 6), torch.eye(3).expand(1, 16, 3, 3))
    with pytest.raises(ShapeError, match=r"torch\.float64"):
        layer(torch.zeros(1, 6), torch.zeros(1, 16, 3, dtype=torch.float16))
