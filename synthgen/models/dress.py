"""Separate meshes that follow a body: eyes, lashes, teeth, tongue, and a garment by default.

An attachment is skinned by the body's joints like the body itself. Those with bases of their own
follow shape and expression by them; the garment is bound to the skin beneath it, and takes weights,
components and pose correctives from there. Where a crease closes on it (a hip that sits), the cloth
is laid on that skin: what is then still inside the body lies where the skin itself overlaps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from synthgen.errors import ModelError
from synthgen.geometry.normals import unit, vertex_normals
from synthgen.models.arguments import checked
from synthgen.models.chain import chain
from synthgen.models.pose_features import feature_joints, rotations_and_features
from synthgen.models.reference import rest
from synthgen.models.shipped import shipped_extras

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel

Array = NDArray[np.float64]
# Distance from the skin of cloth that a crease has swallowed, metres.
_LAID_M = 1e-3


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
    skin_ids : (A, 3) int64, skin_shares : (A, 3), or None
        The skin beneath each vertex of what is bound to the skin.
    """

    name: str
    template: Array
    shapedirs: Array
    exprdirs: Array | None
    posedirs: sparse.csr_matrix | None
    weights: Array
    faces: NDArray[np.int64]
    colour: NDArray[np.uint8]
    skin_ids: NDArray[np.int64] | None = None
    skin_shares: Array | None = None


def attachments_of(model: BodyModel) -> tuple[Attachment, ...]:
    """Return what a shipped body wears and holds; nothing for published and users' files."""
    return read_attachments(model, shipped_extras(model.name))


def read_attachments(body: BodyModel, extras: Mapping[str, Any]) -> tuple[Attachment, ...]:
    """Read every attachment of a shipped model.

    Parameters
    ----------
    body : BodyModel
        The model that they belong to.
    extras : mapping of str to array
        The other arrays of its file: ``attachments`` (names), ``garment_*``, ``eyes_*``, ...

    Raises
    ------
    ModelError
        If an attachment that is named has no arrays, or they do not fit the body.
    """
    try:
        return tuple(_read(body, extras, str(name)) for name in extras.get("attachments", ()))
    except KeyError as error:
        raise ModelError(f"no {error.args[0]!r}, which attachments needs") from None
    except (ValueError, IndexError, TypeError) as error:
        raise ModelError(f"attachments do not fit the body ({error})") from None


def _read(body: BodyModel, extras: Mapping[str, Any], name: str) -> Attachment:
    exprdirs: Array | None
    posedirs: sparse.csr_matrix | None = None
    ids: NDArray[np.int64] | None = None
    share: Array | None = None
    if f"{name}_bind_ids" in extras:
        ids, share = _beneath(extras, name)
        bind, used = _binding(ids, share)
        shapedirs = _bound(bind, body.shapedirs[used])
        exprdirs = None if body.exprdirs is None else _bound(bind, body.exprdirs[used])
        weights = np.asarray(bind @ body.weights[used])
        posedirs = _bound_correctives(bind, body.posedirs[used])
    else:
        shapedirs = np.asarray(extras[f"{name}_shapedirs"], dtype=np.float64)
        own = extras.get(f"{name}_exprdirs")
        exprdirs = None if own is None else np.asarray(own, dtype=np.float64)
        weights = _own_weights(extras, name, body.weights.shape[1])
    made = Attachment(
        name=name,
        template=np.asarray(extras[f"{name}_template"], dtype=np.float64),
        shapedirs=shapedirs,
        exprdirs=exprdirs,
        posedirs=posedirs,
        weights=weights,
        faces=np.asarray(extras[f"{name}_f"], dtype=np.int64),
        colour=np.asarray(extras[f"{name}_colour"], dtype=np.uint8),
        skin_ids=ids,
        skin_shares=share,
    )
    _check(made)
    return made


def _check(made: Attachment) -> None:
    """Refuse what does not belong together, before it is posed."""
    a, faces = len(made.template), made.faces
    shapes = [made.template.shape[1:], made.shapedirs.shape[:2], made.weights.shape[:1]]
    if shapes != [(3,), (a, 3), (a,)] or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"{made.name} has arrays of different lengths")
    if faces.size and not 0 <= faces.min() <= faces.max() < a:
        raise ValueError(f"{made.name}_f refers to vertices beyond its {a}")
    for part in (made.template, made.shapedirs, made.weights):
        if not np.isfinite(part).all():
            raise ValueError(f"{made.name} holds NaN or infinity, or weights that sum to 0")


def _beneath(extras: Mapping[str, Any], name: str) -> tuple[NDArray[np.int64], Array]:
    """Skin vertices (A, 3) beneath what is bound to the skin, and their shares, summing to 1."""
    ids = np.asarray(extras[f"{name}_bind_ids"], dtype=np.int64)
    share = np.asarray(extras[f"{name}_bind_weights"], dtype=np.float64)
    if ids.min(initial=0) < 0 or not (share.sum(axis=1) > 0).all():
        raise ValueError(f"{name}_bind_* hold negative ids, or weights that sum to 0")
    return ids, share / share.sum(axis=1, keepdims=True)


def _binding(ids: NDArray[np.int64], share: Array) -> tuple[sparse.csr_matrix, NDArray[np.int64]]:
    """Matrix (A, n) of the shares, and the n skin vertices that are its columns."""
    used, columns = np.unique(ids, return_inverse=True)
    rows = np.repeat(np.arange(len(ids)), ids.shape[1])
    shape = (len(ids), len(used))
    return sparse.csr_matrix((share.ravel(), (rows, columns.ravel())), shape), used


def _own_weights(extras: Mapping[str, Any], name: str, n_joints: int) -> Array:
    joint = np.asarray(extras[f"{name}_weights_joint"], dtype=np.int64)
    value = np.asarray(extras[f"{name}_weights_value"], dtype=np.float64)
    result = np.zeros((len(joint), n_joints))
    np.add.at(result, (np.arange(len(joint))[:, None], joint), value)
    return np.asarray(result / result.sum(axis=1, keepdims=True))


def _bound(bind: sparse.csr_matrix, bases: NDArray[Any]) -> Array:
    flat = bind @ bases.reshape(len(bases), -1).astype(np.float64)
    return np.asarray(flat).reshape(-1, *bases.shape[1:])


def _bound_correctives(bind: sparse.csr_matrix, posedirs: NDArray[Any]) -> sparse.csr_matrix:
    """Correctives (3 A, F) of what is bound to skin with correctives (n, 3, F)."""
    flat = sparse.csr_matrix(posedirs.reshape(-1, posedirs.shape[2]).astype(np.float64))
    return sparse.csr_matrix(sparse.kron(bind, sparse.eye_array(3), format="csr") @ flat)


def dressed(
    model: BodyModel,
    attachments: Sequence[Attachment],
    shape: NDArray[Any],
    pose: NDArray[Any],
    translation: NDArray[Any] | None = None,
    expression: NDArray[Any] | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Pose attachments as ``model.evaluate`` poses the body; same arguments.

    Returns
    -------
    dict of str to (B, A, 3) float32
        World vertices, metres, by the attachment's name.
    """
    given = checked(model, shape, pose, translation, expression)
    if not len(given.pose):
        return {a.name: np.zeros((0, len(a.template), 3), np.float32) for a in attachments}
    rotations, features = rotations_and_features(model, given.pose)
    rows = zip(given.shape, given.expression, strict=True)
    joints = np.stack([rest(model, beta, psi)[1] for beta, psi in rows])
    frames = chain(rotations, joints, model.parents)
    frames[..., :3, 3] += given.translation[:, None]
    feature = features[:, feature_joints(model)[0] :].reshape(len(features), -1)
    result = {
        a.name: pose_attachment(a, given.shape, frames, joints, feature, given.expression)
        for a in attachments
    }
    bound = [a for a in attachments if a.skin_ids is not None]
    if bound:
        psi = given.expression if model.n_expression else None
        skins = model.evaluate(given.shape, given.pose, given.translation, psi).vertices
        for a in bound:
            for points, skin in zip(result[a.name], skins, strict=True):
                _lay_on_skin(a, points, skin, model.faces)
    return result


def _lay_on_skin(
    attachment: Attachment, points: NDArray[Any], skin: NDArray[Any], faces: NDArray[np.int64]
) -> None:
    """Lay those of points (A, 3) that are inside the skin (V, 3) on what is beneath them."""
    import igl

    body = skin.astype(np.float64)
    inside = igl.fast_winding_number(body, faces, points.astype(np.float64)) > 0.5
    if not inside.any() or attachment.skin_ids is None or attachment.skin_shares is None:
        return
    ids, share = attachment.skin_ids[inside], attachment.skin_shares[inside]
    foot = np.einsum("nk,nkc->nc", share, body[ids])
    normal = unit(np.einsum("nk,nkc->nc", share, vertex_normals(body, faces)[ids]))
    points[inside] = foot + _LAID_M * normal


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
