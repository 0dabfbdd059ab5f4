"""Names and orders of hand joints and keypoints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from synthgen.models.model import BodyModel, Posed

FINGERS: Final = ("index", "middle", "pinky", "ring", "thumb")
MANO16_NAMES: Final = ("wrist", *(f"{f}{k}" for f in FINGERS for k in (1, 2, 3)))
MANO16_PARENTS: Final = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)

# MANO-21 = the 16 joints, then thumb, index, middle, ring, pinky tips.
OPENPOSE21_FROM_MANO21: Final = (
    0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20,
)  # fmt: skip
OPENPOSE21_NAMES: Final = (
    "wrist",
    *(f"{f}_{k}" for f in ("thumb", "index", "middle", "ring", "pinky") for k in range(1, 5)),
)
OPENPOSE21_BONES: Final = tuple(
    (0 if k == 0 else 4 * f + k, 4 * f + k + 1) for f in range(5) for k in range(4)
)
# MANO joint whose bone carries each OpenPose keypoint (tips ride on the last joint).
OPENPOSE21_JOINT: Final = (0, 13, 14, 15, 15, 1, 2, 3, 3, 4, 5, 6, 6, 10, 11, 12, 12, 7, 8, 9, 9)

# Fingertip vertices of 778-vertex MANO meshes; libraries disagree, so the choice has a name.
MANO778_TIPS: Final = {
    "smplx": (744, 320, 443, 554, 671),
    "freihand": (744, 320, 443, 555, 672),
    "manopth": (745, 317, 444, 556, 673),
}
PART_FOREARM: Final = 17
PART_SLEEVE: Final = 18
PART_OBJECT: Final = 19


def openpose21(model: BodyModel, posed: Posed) -> NDArray[np.float32]:
    """Return the 21 hand keypoints in OpenPose order.

    Parameters
    ----------
    model : BodyModel
        Whose ``fingertip_ids`` give the tips.
    posed : Posed

    Returns
    -------
    (B, 21, 3) float32, metres
    """
    tips = posed.vertices[:, model.fingertip_ids]
    return np.concatenate([posed.joints, tips], axis=1)[:, OPENPOSE21_FROM_MANO21]
