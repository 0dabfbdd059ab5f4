"""Moving poses between coordinate frames: the root turns about joint 0, not about the origin.

A posed vertex is ``R (v - J0) + J0 + t`` at the root, with J0 the *rest* position of joint 0,
which depends on the shape. Turning everything by (R', c'), x -> R' x + c', therefore changes the
translation by more than ``R' t + c'``; forgetting that is the usual mistake with these models.

SUPR files hold correctives for the root too. Where those are not zero the mesh itself changes
with the root's rotation, and only the joints move rigidly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle
from synthgen.models.arguments import checked
from synthgen.models.reference import rest

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]


def recentre(
    model: BodyModel,
    shape: NDArray[Any],
    pose: NDArray[Any],
    translation: NDArray[Any],
    T_dst_from_src: NDArray[Any],
    expression: NDArray[Any] | None = None,
) -> tuple[Array, Array]:
    """Express poses in another frame, so that vertices there are the moved vertices.

    Parameters
    ----------
    model : BodyModel
    shape : (B, nb), pose : (B, K, 3) or (B, P), translation : (B, 3), expression : (B, ne) or None
        As ``BodyModel.evaluate``.
    T_dst_from_src : (4, 4) or (B, 4, 4) float
        Rigid motion, for example ``camera.T_camera_from_world``; metres.

    Returns
    -------
    pose : as given, float64
        With the new root rotation R' R.
    translation : (B, 3) float64
        R' (J0 + t) + c' - J0.

    Raises
    ------
    ShapeError
        If shapes do not fit or the motion is not rigid.
    """
    given = checked(model, shape, pose, translation, expression)
    n = len(given.pose)
    motion = _rigid(np.asarray(T_dst_from_src, dtype=np.float64), n)
    turn, shift = motion[:, :3, :3], motion[:, :3, 3]
    root = np.array(
        [rest(model, b, e)[1][0] for b, e in zip(given.shape, given.expression, strict=True)]
    ).reshape(n, 3)
    moved = np.einsum("bij,bj->bi", turn, root + given.translation) + shift - root
    turned = given.pose.copy()
    if turned.ndim == 4:
        turned[:, 0] = turn @ turned[:, 0]
        return turned, moved
    flat, columns = turned.reshape(n, model.n_pose), _root_columns(model, turned)
    flat[:, columns] = axis_angle_from_matrix(turn @ matrix_from_axis_angle(flat[:, columns]))
    return flat.reshape(given.pose.shape), moved


def _root_columns(model: BodyModel, pose: Array) -> NDArray[np.int64]:
    """Return which numbers of a flattened pose are the root's axis-angle."""
    tree = model.axis_meta
    if tree is None or pose.ndim == 3:
        return np.arange(3)
    row = int(tree.order[0])
    if row >= len(tree.spherical):
        raise ShapeError(f"the root of {model.name!r} is a hinge and cannot be turned freely")
    return np.asarray(tree.spherical[row])


def _rigid(given: Array, n: int) -> Array:
    """Return one motion (n, 4, 4) per sample, all of them rigid."""
    if given.shape not in ((4, 4), (n, 4, 4)):
        raise ShapeError(f"T_dst_from_src is {given.shape}; expected (4, 4) or ({n}, 4, 4)")
    motion = np.broadcast_to(given, (n, 4, 4))
    turn = motion[:, :3, :3]
    error = np.abs(turn @ np.swapaxes(turn, -1, -2) - np.eye(3)).max() if len(motion) else 0.0
    finite = np.isfinite(given).all()
    if not finite or not error < 1e-6 or np.any(np.linalg.det(turn) < 0):
        raise ShapeError(
            f"T_dst_from_src is not rigid (R R' is {error:.2g} off the identity); a scale or "
            "mirroring cannot be put into a pose"
        )
    return motion
