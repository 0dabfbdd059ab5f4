"""Separate meshes that follow a body: eyes, lashes, teeth, tongue, and a garment by default.

An attachment is skinned by the body's joints like the body itself. Those with bases of their own
follow shape and expression by them; the garment is bound to the skin beneath it, and takes weights,
components and pose correctives from there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from synthgen.errors import ModelError
from synthgen.models.compact import dequantised, expressions, skinning_weights

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Attachment:
    """A mesh that is posed with a body.

    Attributes
    ----------
    name : str
    template : (A, 3) metres, in the body's rest frame
    shapedirs : (A, 3, nb) metres per standard deviation
    exprdirs : (A, 3, ne) or None
    posedirs : sparse (3 A, F) or None
        Rest-pose offsets for the body's pose feature: ``R - I`` of the joints after the root
        (SMPL+H), or quaternions minus identity of all joints (SUPR).
    weights : (A, K), rows sum to 1
    faces : (Fa, 3) int64
    colour : (Fa, 3) uint8, sRGB
    """

    name: str
    template: Array
    shapedirs: Array
    exprdirs: Array | None
    posedirs: sparse.csr_matrix | None
    weights: Array
    faces: NDArray[np.int64]
    colour: NDArray[np.uint8]


def read_attachments(arrays: dict[str, Any]) -> tuple[Attachment, ...]:
    """Read every attachment of a shipped model's compact arrays.

    Raises
    ------
    ModelError
        If an attachment that is named has no arrays.
    """
    try:
        return tuple(_read(arrays, str(name)) for name in arrays.get("attachments", ()))
    except KeyError as error:
        raise ModelError(f"no {error.args[0]!r}, which attachments needs") from None


def _read(arrays: dict[str, Any], name: str) -> Attachment:
    exprdirs: Array | None
    posedirs: sparse.csr_matrix | None = None
    if f"{name}_bind_ids" in arrays:
        bind = _binding(arrays, name)
        shapedirs = _bound(bind, dequantised(arrays, "shapedirs"))
        exprdirs = _bound(bind, expressions(arrays)) if "exprdirs_q" in arrays else None
        weights = np.asarray(bind @ skinning_weights(arrays))
        posedirs = _bound_correctives(bind, arrays)
    else:
        shapedirs = np.asarray(arrays[f"{name}_shapedirs"], dtype=np.float64)
        own = arrays.get(f"{name}_exprdirs")
        exprdirs = None if own is None else np.asarray(own, dtype=np.float64)
        weights = skinning_weights(arrays, f"{name}_")
    return Attachment(
        name=name,
        template=np.asarray(arrays[f"{name}_template"], dtype=np.float64),
        shapedirs=shapedirs,
        exprdirs=exprdirs,
        posedirs=posedirs,
        weights=weights,
        faces=np.asarray(arrays[f"{name}_f"], dtype=np.int64),
        colour=np.asarray(arrays[f"{name}_colour"], dtype=np.uint8),
    )


def _binding(arrays: dict[str, Any], name: str) -> sparse.csr_matrix:
    """Matrix (A, V) of the skin vertices' shares, rows summing to 1."""
    ids = np.asarray(arrays[f"{name}_bind_ids"], dtype=np.int64)
    share = np.asarray(arrays[f"{name}_bind_weights"], dtype=np.float64)
    share = share / share.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(ids)), ids.shape[1])
    shape = (len(ids), len(arrays["v_template"]))
    return sparse.csr_matrix((share.ravel(), (rows, ids.ravel())), shape)


def _bound(bind: sparse.csr_matrix, bases: NDArray[Any]) -> Array:
    flat = bind @ bases.reshape(len(bases), -1).astype(np.float64)
    return np.asarray(flat).reshape(-1, *bases.shape[1:])


def _bound_correctives(bind: sparse.csr_matrix, arrays: dict[str, Any]) -> sparse.csr_matrix:
    blocks = arrays["posedirs_blocks"] * float(arrays["posedirs_scale"])
    vertex, joint = (np.asarray(arrays[f"posedirs_{k}"], np.int64) for k in ("vertex", "joint"))
    n, _, b = blocks.shape
    first = 1 if b == 9 else 0  # SMPL+H: no feature of the root
    rows = (3 * vertex[:, None] + np.arange(3))[:, :, None]
    columns = ((joint[:, None] - first) * b + np.arange(b))[:, None, :]
    where = (np.broadcast_to(rows, (n, 3, b)).ravel(), np.broadcast_to(columns, (n, 3, b)).ravel())
    shape = (3 * bind.shape[1], b * (arrays["kintree_table"].shape[1] - first))
    dense = sparse.csr_matrix((blocks.ravel(), where), shape)
    return sparse.csr_matrix(sparse.kron(bind, sparse.eye_array(3), format="csr") @ dense)


def pose_attachment(
    attachment: Attachment,
    shape: NDArray[Any],
    transforms: NDArray[Any],
    rest_joints: NDArray[Any],
    feature: NDArray[Any] | None = None,
    expression: NDArray[Any] | None = None,
) -> NDArray[np.float32]:
    """Pose an attachment together with its body.

    Parameters
    ----------
    attachment : Attachment
    shape : (B, nb) float
        The body's betas; fewer than the attachment's are filled with zeros.
    transforms : (B, K, 4, 4) float
        The posed body's joint frames, translation included.
    rest_joints : (B, K, 3) float
        The shaped body's joints before posing, metres.
    feature : (B, F) float or None
        The body's pose feature; None leaves out pose correctives.
    expression : (B, ne) float or None

    Returns
    -------
    (B, A, 3) float32, metres
    """
    betas = np.asarray(shape, dtype=np.float64)
    rest = attachment.template + np.einsum(
        "acn,bn->bac", attachment.shapedirs[..., : betas.shape[1]], betas
    )
    if expression is not None and attachment.exprdirs is not None:
        psi = np.asarray(expression, dtype=np.float64)
        rest = rest + np.einsum("acn,bn->bac", attachment.exprdirs[..., : psi.shape[1]], psi)
    if feature is not None and attachment.posedirs is not None:
        moved = attachment.posedirs @ np.asarray(feature, dtype=np.float64).T
        rest = rest + np.asarray(moved).T.reshape(rest.shape)
    frames = np.asarray(transforms, dtype=np.float64)[..., :3, :]
    turn = frames[..., :3]
    shift = frames[..., 3] - (turn @ np.asarray(rest_joints, np.float64)[..., None])[..., 0]
    blended = np.einsum("ak,bkij->baij", attachment.weights, turn)
    posed = (blended @ rest[..., None])[..., 0] + np.einsum(
        "ak,bki->bai", attachment.weights, shift
    )
    return np.asarray(posed, dtype=np.float32)
