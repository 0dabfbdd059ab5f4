"""Expression components from MakeHuman's face units (ARKit's names).

Units are drawn with independent strengths, left and right ones nearly together; the components
are the principal ones of that, about the neutral face, of unit variance. The jaw's opening is left
to the jaw's joint.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.cc0.foundation import Foundation
from synthgen.cc0.packing import packed_expressions

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_BY_JOINT = ("jawOpen", "jawLeft", "jawRight", "jawForward", "tongueOut")
STRENGTH_SD, SIDES_TOGETHER = 0.22, 0.85
MOST = 50
EYE_REACH_M = 0.045


def expression_space(base: Foundation) -> tuple[Array, dict[str, Any]]:
    """Return components (S, 3, n), metres per standard deviation, and the named units' arrays.

    ``expression_units`` (u, n) holds the coordinates that show each unit of
    ``expression_unit_names`` at full strength.
    """
    units = base.source.face_units()
    names = [name for name in units if name not in _BY_JOINT]
    place = np.full(len(base.source.vertices), -1)
    place[base.cut.ids] = np.arange(len(base.cut.ids))
    moved = np.zeros((len(names), len(base.cut.ids), 3))
    for row, name in zip(moved, names, strict=True):
        ids, offsets = _mended(base, name, *units[name])
        local = place[ids]
        row[local[local >= 0]] = offsets[local >= 0]
    moved *= _head_size(base)
    _, values, axes = np.linalg.svd(
        np.linalg.cholesky(_covariance(names)).T @ moved.reshape(len(names), -1),
        full_matrices=False,
    )
    n = min(MOST, int((values > 1e-3 * values[0]).sum()))
    axes *= np.sign(axes[np.arange(len(axes)), np.abs(axes).argmax(axis=1)])[:, None]
    components = values[:n, None] * axes[:n]
    coordinates = moved.reshape(len(names), -1) @ axes[:n].T / values[:n]
    extra = {
        "expression_unit_names": np.array(names),
        "expression_units": coordinates.astype(np.float32),
    }
    return components.reshape(n, -1, 3).transpose(1, 2, 0), extra


def _mended(base: Foundation, name: str, ids: Ints, offsets: Array) -> tuple[Ints, Array]:
    """Drop what an eye's unit moves far from that eye: single vertices of the mouth's inside."""
    if not name.startswith("eye"):
        return ids, offsets
    side = "r" if name.endswith("Right") else "l"
    points = base.source.vertices
    eye = points[np.unique(base.source.groups[f"helper-{side}-eye"].vertices)].mean(axis=0)
    near = np.linalg.norm(points[ids] - eye, axis=1) < EYE_REACH_M
    return ids[near], offsets[near]


def _covariance(names: list[str]) -> Array:
    result = np.eye(len(names))
    for i, name in enumerate(names):
        twin = name.replace("Left", "Right")
        if twin != name and twin in names:
            j = names.index(twin)
            result[i, j] = result[j, i] = SIDES_TOGETHER
    return result * STRENGTH_SD**2


def _head_size(base: Foundation) -> float:
    """Height of the template's head against that of the base mesh, which the units were made on."""
    head = np.flatnonzero(base.rest.weights[:, base.skeleton.index("head")] > 0.9)
    ours, theirs = base.template[head], base.source.vertices[head]
    return float(np.ptp(ours[:, 1]) / np.ptp(theirs[:, 1]))


def packed_face(base: Foundation, components: Array, extra: dict[str, Any]) -> dict[str, Any]:
    """Pack the body's part of the expression space."""
    return packed_expressions("exprdirs", components[: base.cut.n_body]) | extra
