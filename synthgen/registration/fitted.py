"""What a fit returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from synthgen.models import BodyModel
from synthgen.registration.verdict import Verdict

Array = NDArray[np.float64]
Side = Literal["left", "right"]


@dataclass(frozen=True, eq=False)
class Fit:
    """A registered hand or body.

    Attributes
    ----------
    shape : (nb,), pose : (K, 3) axis-angle, translation : (3,) metres
        Of ``model``; world frame of the points.
    expression : (ne,) or None
        Of a SUPR body.
    hand : "left", "right" or None
        None: a body.
    vertices : (V, 3), joints : (K, 3), metres
    verdict : "pass", "unobserved" or "fail"
    reason : str
        "" for pass, else from ``verdict.REASONS``, with parts: ``hole(ring)``.
    report : dict
        JSON types: statistics, stages, times, candidates.
    model : BodyModel
        Whose parameters they are: of the side that was found.
    vertex_sd_m : (V,)
        Predicted standard deviation of each vertex; empty where nothing was finished.
    free_vertices : (V, 3) or None
        The mesh of the coupled stage, where asked for and the fit was not a fail.
    """

    shape: Array
    pose: Array
    translation: Array
    hand: Side | None
    vertices: Array
    joints: Array
    verdict: Verdict
    reason: str
    report: dict[str, Any]
    model: BodyModel
    expression: Array | None = None
    vertex_sd_m: Array = field(default_factory=lambda: np.zeros(0))
    free_vertices: Array | None = None
