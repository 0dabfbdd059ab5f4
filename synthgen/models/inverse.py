"""The way back from angles to the coefficients of a hand's pose space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, ShapeError
from synthgen.models.hand_pca import finger_joints

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel, Hand

Array = NDArray[np.float64]


def pca_from_pose(
    model: BodyModel,
    pose: NDArray[Any],
    *,
    flat_hand_mean: bool,
    n: int | None = None,
    hand: Hand | None = None,
) -> tuple[Array, Array]:
    """Return the PCA coefficients of a hand that come closest to axis-angle poses.

    The published components are close to orthonormal but not exactly so; a transpose would miss
    by that much, least squares does not.

    Parameters
    ----------
    model : BodyModel
        With the pose space of that hand.
    pose : (B, K, 3) or (B, 45) float
        Of the whole model, or of the 15 finger joints alone; radians, mean included.
    flat_hand_mean : bool
        True if zero coefficients mean a flat hand, False if they mean ``hands_mean``.
    n : int or None
        Leading components used; None: all.
    hand : "left", "right" or None
        Which hand of a body; None: the only one of a hand model.

    Returns
    -------
    coefficients : (B, n) float64
    residual : (B,) float64
        Root mean square of what n components cannot express, radians.

    Raises
    ------
    ModelError
        If the model has no such pose space.
    ShapeError
        If the pose or ``n`` does not fit.
    """
    side = hand or model.hand
    space = None if side is None else model.hand_space(side)
    if side is None or space is None:
        raise ModelError(
            f"model {model.name!r} has no pose space of the {side or 'one'} hand; name a hand of a "
            "body, or load the file together with the MANO pair"
        )
    values = np.asarray(pose, dtype=np.float64)
    if values.ndim == 3:
        values = values[:, finger_joints(model, side)].reshape(len(values), -1)
    if values.ndim != 2 or values.shape[1] != len(space.mean):
        raise ShapeError(
            f"pose has shape {np.shape(pose)}; expected (B, {len(model.parents)}, 3) or (B, 45)"
        )
    rows = space.components[:n]
    if n is not None and not 1 <= n <= len(space.components):
        raise ShapeError(f"n={n}; the hand has 1 to {len(space.components)} components")
    wanted = values if flat_hand_mean else values - space.mean
    coefficients = np.linalg.lstsq(rows.T, wanted.T)[0].T
    left = wanted - coefficients @ rows
    return np.asarray(coefficients), np.asarray(np.sqrt(np.mean(left**2, axis=1)))
