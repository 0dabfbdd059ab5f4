"""A subject's own template: what a model's shape space lacks, averaged over frames (Eq. 20-23).

Free meshes of a few frames are brought back to the rest pose and averaged (Embodied Hands, 4.3.1,
after Loper et al. 2015); the model with that template is then tracked with its shape frozen.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ShapeError
from synthgen.models import BodyModel

Array = NDArray[np.float64]
# A blend of joints' rotations that squeezes skin below this tells nothing about the rest pose; the
# paper's authors sorted such unposing artefacts out by eye.
LEAST_STRETCH = 0.6
# A vertex that no scan point touched is carried by its neighbours: it counts where nothing else is.
UNSEEN_WEIGHT = 0.02


@dataclass(frozen=True, eq=False)
class Aligned:
    """One frame: a model's parameters and the mesh that the coupled stage freed from it.

    Attributes
    ----------
    shape : (nb,), pose : (K, 3) radians, translation : (3,) metres
    vertices : (V, 3), metres
        The free mesh.
    seen : (V,) bool or None
        Vertices with data; None: all.
    expression : (ne,) or None
    """

    shape: Array
    pose: Array
    translation: Array
    vertices: Array
    seen: NDArray[np.bool_] | None = None
    expression: Array | None = None


def unposed(model: BodyModel, frame: Aligned) -> tuple[Array, Array]:
    """Bring a free mesh back to the rest pose.

    Returns
    -------
    rest : (V, 3) metres
        Shaped template plus what the mesh adds to the model; pose correctives cancel.
    weight : (V,)
        How much each vertex can be trusted.

    Raises
    ------
    ShapeError
        If the mesh is not the model's.
    """
    if frame.vertices.shape != model.v_template.shape:
        raise ShapeError(
            f"free mesh {frame.vertices.shape} for model {model.name!r} with vertices "
            f"{model.v_template.shape}; fit this model with the coupled stage"
        )
    given = [frame.shape[None], frame.pose[None], frame.translation[None],
             None if frame.expression is None else frame.expression[None]]  # fmt: skip
    posed = model.evaluate(*given)  # type: ignore[arg-type]
    blend = np.einsum("vk,kab->vab", model.weights, posed.transforms[0, :, :3, :3])
    added = np.asarray(frame.vertices, np.float64) - posed.vertices[0]
    stretch = np.linalg.svd(blend, compute_uv=False)[:, 2]
    good = stretch >= LEAST_STRETCH
    safe = np.where(good[:, None, None], blend, np.eye(3))
    rest = model.shaped(frame.shape, frame.expression)[0]
    rest = rest + np.where(good[:, None], np.linalg.solve(safe, added[..., None])[..., 0], 0.0)
    seen = np.ones(len(rest), bool) if frame.seen is None else frame.seen
    return rest, np.where(good, np.where(seen, 1.0, UNSEEN_WEIGHT), 1e-6)


def subject_offset(
    model: BodyModel, frames: Sequence[Aligned], shape: Array, share: Array | None = None
) -> Array:
    """Return what a subject's template adds (V, 3) to the model's, at betas that it keeps.

    Parameters
    ----------
    model : BodyModel
    frames : sequence of Aligned
    shape : (nb,)
        The subject's betas; :func:`with_offset` at these is the subject.
    share : (V,) or None
        How much of the offset each vertex takes, 0..1; None: all.
    """
    own = subject_template(model, frames).v_template
    faces = [f.expression for f in frames if f.expression is not None]
    offset = own - model.shaped(shape, np.mean(faces, axis=0) if faces else None)[0]
    return np.asarray(offset if share is None else share[:, None] * offset)


def with_offset(model: BodyModel, offset: Array) -> BodyModel:
    """Return the model with a subject's offset (V, 3) on its template."""
    template = model.v_template + offset
    mark = hashlib.sha256(model.digest.encode() + template.tobytes()).hexdigest()
    return replace(model, name=f"{model.name} (subject)", digest=mark, v_template=template)


def subject_template(model: BodyModel, frames: Sequence[Aligned]) -> BodyModel:
    """Return the model with a subject's own template; shape zero is the subject.

    Parameters
    ----------
    model : BodyModel
    frames : sequence of Aligned
        Some frames of one subject, of different poses if possible; five are enough.

    Raises
    ------
    ShapeError
        If there is no frame, or a mesh is not the model's.
    """
    if not frames:
        raise ShapeError("a subject's template needs at least one aligned frame; none was given")
    parts = [unposed(model, frame) for frame in frames]
    weight = np.stack([w for _, w in parts])
    template = np.average(np.stack([rest for rest, _ in parts]), axis=0,
                          weights=np.repeat(weight[..., None], 3, axis=2))  # fmt: skip
    basis = model.joint_basis
    if basis is not None:  # joints hang on vertices that were cut away: keep the shaped ones
        joints = [model.shaped(frame.shape, frame.expression)[1] for frame in frames]
        basis = np.concatenate([np.mean(joints, axis=0)[None], basis[1:]])
    mark = hashlib.sha256(model.digest.encode() + template.tobytes()).hexdigest()
    return replace(
        model, name=f"{model.name} (subject)", digest=mark, v_template=template, joint_basis=basis
    )
