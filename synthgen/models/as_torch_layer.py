"""Models as differentiable torch modules, over the same kernels as everything else.

The file is not named after its function, or importing it would hide ``synthgen.models.as_torch``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from synthgen.errors import ShapeError
from synthgen.models.model import BodyModel
from synthgen.models.vjp import forward

_TYPES: dict[torch.dtype, type[np.float32] | type[np.float64]] = {
    torch.float32: np.float32,
    torch.float64: np.float64,
}


class TorchPosed(NamedTuple):
    """Vertices (B, V, 3) and joints (B, K, 3), metres, differentiable."""

    vertices: torch.Tensor
    joints: torch.Tensor


class TorchModel(torch.nn.Module):
    """A model as a torch layer without parameters of its own.

    Runs on the CPU; tensors of other devices are copied there and back. Gradients are analytic
    and can be taken once: a second differentiation (``create_graph=True`` and backward again)
    raises torch's RuntimeError. For second-order methods use ``BodyModel.jacobian``.
    """

    def __init__(self, model: BodyModel) -> None:
        super().__init__()
        self.model = model

    def forward(
        self,
        shape: torch.Tensor,
        pose: torch.Tensor,
        translation: torch.Tensor | None = None,
        expression: torch.Tensor | None = None,
    ) -> TorchPosed:
        """Evaluate a batch; float64 poses are evaluated in float64, others in float32.

        Parameters
        ----------
        shape : (B, nb) float tensor
        pose : (B, K, 3) axis-angle, or (B, P) angles of a constrained tree
        translation : (B, 3) or None
        expression : (B, ne) or None

        Raises
        ------
        ShapeError
            If shapes or types do not fit, or the pose is given as matrices.
        """
        if pose.ndim == 4:
            raise ShapeError(
                "as_torch takes axis-angle (B, K, 3): nine entries of a matrix have no gradient "
                "that keeps it a rotation"
            )
        if pose.dtype not in _TYPES:
            raise ShapeError(f"pose is {pose.dtype}; expected torch.float32 or torch.float64")
        n = len(pose)
        moved = pose.new_zeros((n, 3)) if translation is None else translation
        psi = pose.new_zeros((n, 0)) if expression is None else expression
        vertices, joints = _Evaluate.apply(self.model, shape, pose, moved, psi)  # type: ignore[no-untyped-call]
        return TorchPosed(vertices, joints)


class _Evaluate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, model: BodyModel, *inputs: torch.Tensor) -> tuple[Any, ...]:
        shape, pose, moved, psi = (t.detach().cpu().numpy() for t in inputs)
        expression = psi if psi.shape[1] else None
        state = forward(model, shape, pose, moved, expression, dtype=_TYPES[inputs[1].dtype])
        ctx.state, ctx.kinds = state, [(t.dtype, t.device) for t in inputs]
        like = inputs[1]
        results = (state.vertices, state.joints)
        return tuple(torch.as_tensor(a).to(like.device, like.dtype) for a in results)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[Any, ...]:
        g = ctx.state.pull(*(t.detach().cpu().numpy() for t in grads))
        parts = zip((g.shape, g.pose, g.translation, g.expression), ctx.kinds, strict=True)
        return (None, *(torch.as_tensor(a).to(device, dtype) for a, (dtype, device) in parts))


def as_torch(model: BodyModel) -> TorchModel:
    """Wrap a model as a differentiable torch module.

    >>> layer = synthgen.models.as_torch(model)                    # doctest: +SKIP
    >>> loss = layer(shape, pose, translation).vertices.square().mean()   # doctest: +SKIP
    """
    return TorchModel(model)
