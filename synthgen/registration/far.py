"""Scans far from the origin, such as georeferenced ones: they are fitted near it.

The coarse stage works in float32, which at a million metres knows positions to 60 mm only. So whole
metres are subtracted first, in float64, and added to what was found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from synthgen.registration.fitted import Fit
from synthgen.registration.scan import are_positions

Array = NDArray[np.float64]
FAR_M = 100.0
F = TypeVar("F", bound=Callable[..., Fit])


def origin_of(points: Any) -> Array | None:
    """Return whole metres (3,) near the middle of points (N, 3); None where the origin is near."""
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 3:
        return None
    p = p[are_positions(p)]
    if len(p) == 0:
        return None
    middle = np.rint(np.median(p, axis=0))
    return middle if np.linalg.norm(middle) > FAR_M else None


def near_the_origin(fit: F) -> F:
    """Let :func:`synthgen.registration.fit` fit near the origin what is far from it."""

    @wraps(fit)
    def moved(
        points: Any, normals: Any, model: Any, start: Any = "cold", *rest: Any, **known: Any
    ) -> Fit:
        origin = origin_of(points)
        if origin is None:
            return fit(points, normals, model, start, *rest, **known)
        if not isinstance(start, str):
            parts = list(start)
            start = (*parts[:2], *(_from(origin, part) for part in parts[2:3]), *parts[3:])
        if known.get("viewpoints") is not None:
            known["viewpoints"] = _from(origin, known["viewpoints"])
        if known.get("keypoints") is not None:
            joints, positions = known["keypoints"]
            known["keypoints"] = joints, _from(origin, positions)
        return _put_back(fit(_from(origin, points), normals, model, start, *rest, **known), origin)

    return cast("F", moved)


def _from(origin: Array, positions: Any) -> Array:
    return np.asarray(np.asarray(positions, dtype=np.float64) - origin)


def _put_back(found: Fit, origin: Array) -> Fit:
    """Return a fit made as seen from an origin, in the points' own frame."""
    free = found.free_vertices
    return replace(
        found,
        translation=found.translation + origin,
        vertices=found.vertices + origin,
        joints=found.joints + origin,
        free_vertices=None if free is None else free + origin,
    )
