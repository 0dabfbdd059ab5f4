"""Whether the limbs of a posed body lie inside it: forearms, hands, shanks and feet.

Solid is what winds around a point more than half (Jacobson 2013), which also works for the open
mesh that remains when a limb is cut off.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from synthgen.models import BodyModel
from synthgen.models.joints import SIDES

EVERY = 6
# A limb: it is cut off at the first joint and probed beyond the second.
_LIMBS = tuple((f"{side}_{a}", f"{side}_{b}") for side in SIDES
               for a, b in (("shoulder", "elbow"), ("hip", "knee")))  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Limb:
    probes: NDArray[np.int64]
    others: NDArray[np.int64]


def limbs_inside(
    model: BodyModel, shape: NDArray[np.floating], pose: NDArray[np.floating]
) -> float:
    """Return the share of the limbs' skin that lies inside the rest of the body, 0..1.

    Parameters
    ----------
    model : BodyModel
        A whole body.
    shape : (nb,) float
    pose : (K, 3) float
        Axis-angle, radians.
    """
    import igl

    vertices = model.evaluate(shape[None], pose[None]).vertices[0].astype(np.float64)
    inside, probed = 0, 0
    for limb in _limbs(model):
        around = np.asarray(igl.fast_winding_number(vertices, limb.others, vertices[limb.probes]))
        inside += int((around > 0.5).sum())
        probed += len(limb.probes)
    return inside / probed


@lru_cache(maxsize=4)
def _limbs(model: BodyModel) -> tuple[_Limb, ...]:
    strongest = model.weights.argmax(axis=1)
    faces = np.ascontiguousarray(model.faces, dtype=np.int64)
    limbs = []
    for cut, beyond in _LIMBS:
        own = np.isin(strongest, _below(model, cut))
        probes = np.flatnonzero(np.isin(strongest, _below(model, beyond)))[::EVERY]
        limbs.append(_Limb(probes, faces[~own[faces].any(axis=1)]))
    return tuple(limbs)


def _below(model: BodyModel, name: str) -> list[int]:
    """Return a joint and all that hang from it."""
    found = [model.joint_names.index(name)]
    for k, parent in enumerate(model.parents):
        if parent in found:
            found.append(k)
    return found
