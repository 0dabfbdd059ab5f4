"""Checking what is passed to a model; every refusal names value, expectation and way out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]
# A matrix farther from a rotation than this is refused: single precision rounds to 1e-7.
_ROTATION_ERROR = 1e-4
# Far beyond any pose, shape or place; powers of much larger numbers overflow.
_LARGEST = 1e12


@dataclass(frozen=True, eq=False)
class Arguments:
    """Checked arguments, float64.

    Attributes
    ----------
    shape : (B, n) with n <= nb
    pose : (B, K, 3), (B, K, 3, 3) or (B, P)
    translation : (B, 3)
    expression : (B, m) with m <= ne
    """

    shape: Array
    pose: Array
    translation: Array
    expression: Array


def checked(
    model: BodyModel,
    shape: Any,
    pose: Any,
    translation: Any = None,
    expression: Any = None,
    *,
    flat_hand_mean: bool | None = None,
) -> Arguments:
    """Check and convert; arguments as ``BodyModel.evaluate``.

    Raises
    ------
    ShapeError
        If shapes do not fit, a number is not finite or a matrix is no rotation.
    """
    if flat_hand_mean is not None:
        from synthgen.models.hand_pca import expand_pose

        pose = expand_pose(model, pose, flat_hand_mean=flat_hand_mean)
    theta = _numbers(pose, "pose")
    n = len(theta) if theta.ndim else 0
    _check_pose(model, theta)
    betas = _coefficients(shape, n, model.n_shape, "shape", "nb", model.name)
    if expression is not None and model.n_expression == 0:
        raise ShapeError(
            f"model {model.name!r} ({model.family}) has no expression components; pass None"
        )
    psi = np.zeros((n, 0))
    if expression is not None:
        psi = _coefficients(expression, n, model.n_expression, "expression", "ne", model.name)
    moved = np.zeros((n, 3)) if translation is None else _numbers(translation, "translation")
    if moved.shape != (n, 3):
        raise ShapeError(f"translation has shape {moved.shape}; expected ({n}, 3)")
    _check_sizes(("pose", theta), ("shape", betas), ("translation", moved), ("expression", psi))
    if theta.ndim == 4:
        _check_rotations(theta)
    return Arguments(betas, theta, moved, psi)


def _numbers(value: Any, what: str) -> Array:
    """Copy to one kind of array, writable and contiguous: kernels are compiled for that alone."""
    try:
        return np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{what} is no array of numbers: {error}") from None


def _check_pose(model: BodyModel, theta: Array) -> None:
    k = len(model.parents)
    if model.axis_meta is not None and theta.ndim == 2:
        p = model.axis_meta.n_pose
        if theta.shape[1] != p:
            raise ShapeError(
                f"pose has shape {theta.shape}; the constrained model {model.name!r} expects "
                f"(B, {p}) angles"
            )
    elif theta.shape[1:] not in ((k, 3), (k, 3, 3)):
        raise ShapeError(
            f"pose has shape {theta.shape}; expected (B, {k}, 3) axis-angle or (B, {k}, 3, 3) "
            "rotation matrices; for PCA coefficients say flat_hand_mean=True or False"
        )


def _check_rotations(matrices: Array) -> None:
    error = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(initial=0.0)
    lowest = np.linalg.det(matrices).min(initial=1.0)
    if error > _ROTATION_ERROR or lowest < 0:
        raise ShapeError(
            f"pose holds a matrix that is no rotation (R R' is {error:.2g} off the identity, "
            f"lowest determinant {lowest:.3g}); orthonormalise it first"
        )


def _coefficients(value: Any, n: int, most: int, what: str, count: str, name: str) -> Array:
    values = _numbers(value, what)
    if values.ndim != 2 or len(values) != n or values.shape[1] > most:
        raise ShapeError(
            f"{what} is {values.shape}; model {name!r} expected ({n}, {count}) with "
            f"{count} <= {most}, one row per pose"
        )
    return values


def checked_row(value: Any, most: int, what: str, name: str) -> Array:
    """Check the coefficients (n,) of one sample, n <= ``most``.

    Raises
    ------
    ShapeError
        If there are more, or a number is not finite.
    """
    values = _numbers(value, what)
    if values.ndim != 1 or len(values) > most:
        raise ShapeError(
            f"{what} is {values.shape}; one sample of model {name!r} expects (n,) with n <= {most}"
        )
    _check_finite(what, values)
    return values


def _check_sizes(*named: tuple[str, Array]) -> None:
    from synthgen.models.kernels import within

    if within(_LARGEST, *(values.reshape(-1) for _, values in named)):
        return
    for what, values in named:
        _check_finite(what, values)
        largest = np.abs(values).max(initial=0.0)
        if largest > _LARGEST:
            raise ShapeError(
                f"{what} holds {largest:.3g}, which would overflow; expected radians or metres"
            )


def _check_finite(what: str, values: Array) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        raise ShapeError(f"{what} holds {values[~finite][0]}; must be finite")
