"""Poses from one model to another by joint name: SMPL+H, SUPR, STAR and hands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, ShapeError
from synthgen.models.joints import SMPLH52_NAMES, STAR24_NAMES, SUPR75_NAMES
from synthgen.models.model import BodyModel

Array = NDArray[np.float64]
_PUBLISHED = {"smplh": SMPLH52_NAMES, "supr": SUPR75_NAMES, "star": STAR24_NAMES}


@dataclass(frozen=True, eq=False)
class MappedPose:
    """A pose for another model.

    Attributes
    ----------
    pose : (..., K', 3) float64
        Axis-angle; joints that the source lacks are at rest.
    at_rest : tuple of str
        Those joints.
    lost : dict of str to float
        Joints that the target lacks, and the largest angle (radians) that went with them.
    """

    pose: Array
    at_rest: tuple[str, ...]
    lost: dict[str, float]


def map_pose(
    pose: NDArray[Any],
    source: BodyModel | str | Sequence[str],
    target: BodyModel | str | Sequence[str],
) -> MappedPose:
    """Carry a pose over to another model's joints.

    All of these models share the rest pose and joint frames of SMPL, so angles carry over as
    they are. The root turns about the first joint, which is elsewhere in another body: use
    ``synthgen.models.recentre`` where the translation matters.

    Parameters
    ----------
    pose : (..., K, 3) float
        Axis-angle, radians, mean included.
    source, target : BodyModel, "smplh", "supr", "star" or a sequence of joint names

    Returns
    -------
    MappedPose

    Raises
    ------
    ModelError
        If a family is unknown, or the two have no joint in common.
    ShapeError
        If the pose does not fit the source.
    """
    given, wanted = _names(source), _names(target)
    values = np.asarray(pose, dtype=np.float64)
    if values.shape[-2:] != (len(given), 3):
        raise ShapeError(f"pose has shape {values.shape}; expected (..., {len(given)}, 3)")
    place = {name: k for k, name in enumerate(given)}
    if not place.keys() & set(wanted):
        raise ModelError(f"no joint is common to {given[:4]}... and {wanted[:4]}...")
    result = np.zeros((*values.shape[:-2], len(wanted), 3))
    for k, name in enumerate(wanted):
        if name in place:
            result[..., k, :] = values[..., place[name], :]
    angles = np.linalg.norm(values, axis=-1).reshape(-1, len(given)).max(axis=0, initial=0.0)
    lost = {name: float(angles[k]) for name, k in place.items() if name not in wanted}
    return MappedPose(result, tuple(n for n in wanted if n not in place), lost)


def _names(model: BodyModel | str | Sequence[str]) -> tuple[str, ...]:
    if isinstance(model, BodyModel):
        return model.joint_names
    if isinstance(model, str):
        if model not in _PUBLISHED:
            raise ModelError(f"family {model!r}; known are {', '.join(_PUBLISHED)}")
        return _PUBLISHED[model]
    return tuple(model)
