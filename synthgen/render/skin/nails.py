"""Nails: where plates, half-moons, free edges and cuticles lie, and their relief."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.render.skin.sites import Sites
from synthgen.scene.anatomy import Anatomy, Nail
from synthgen.scene.relief import bump

Values = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Nails:
    """Per place (n,) float32.

    Attributes
    ----------
    plate : 0..1
        The nail plate, free edge included.
    along, across : in half lengths and half widths of the plate
        -1 at the root, 1 at the free edge; 2 and 0 off every nail.
    cuticle : 0..1
        Fold of skin around root and sides.
    height : millimetres
    """

    plate: Values
    along: Values
    across: Values
    cuticle: Values
    height: Values


def lay_nails(sites: Sites, anatomy: Anatomy) -> Nails:
    """Lay out the nails of a hand; none where its mesh has none."""
    n = len(sites.points)
    nails = Nails(*(np.zeros(n, np.float32) for _ in range(5)))
    nails.along[:] = 2
    for finger in anatomy.fingers:
        if finger.nail is not None:
            _lay(nails, sites, finger.nail, finger.joints[2])
    return nails


def _lay(nails: Nails, sites: Sites, nail: Nail, joint: int) -> None:
    out = sites.normals @ nail.out.astype(np.float32)
    own = np.flatnonzero((sites.weights[:, joint] > 0.4) & (out > -0.15))
    offset = sites.points[own] - nail.centre.astype(np.float32)
    a, b = 1.02 * nail.half_length, 0.97 * nail.half_width
    u, w = offset @ nail.along, offset @ nail.across
    x = np.abs(w) / b
    behind, ahead = np.maximum(-u, 0) / a, np.maximum(u, 0) / a
    root = (behind**2.2 + x**2.4) ** (1 / 2.3)
    front = (ahead**5 + x**3.2) ** (1 / 3.6)
    edge = (np.where(u < 0, root, front) - 1) * min(a, b)
    soft = max(0.00016, 0.45 * sites.spacing_m)
    plate = np.clip(0.5 - edge / (2 * soft), 0, 1)
    sides = np.clip((0.8 - ahead) / 0.25, 0, 1)
    ring, groove = bump(edge - 0.0009, 0.0008), bump(edge - 0.0001, sites.width(0.00022))
    keep = own[edge < 0.003]
    near = edge < 0.003
    nails.plate[keep] = np.maximum(nails.plate[keep], plate[near])
    nails.along[keep], nails.across[keep] = (u / a)[near], (w / b)[near]
    fold = (groove * sides * np.where(u < 0, 1.0, 0.7) + 0.3 * ring * (u < 0))[near]
    nails.cuticle[keep] = np.maximum(nails.cuticle[keep], np.minimum(fold, 1))
    ridges = 0.003 * np.sin(w / 0.00045) * plate
    arch = 0.03 * plate * (1 - 0.6 * x**2)
    nails.height[keep] += (0.09 * ring * sides - 0.16 * groove * sides + ridges + arch)[near]
