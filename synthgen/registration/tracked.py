"""What tracking works with: a frame's end, and what follows a kind of subject."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from synthgen.registration.fitted import Fit
from synthgen.registration.inspection import Finding
from synthgen.registration.scan import Scan
from synthgen.registration.surface import Surface
from synthgen.registration.template import Aligned
from synthgen.registration.verdict import Judgement

Array = NDArray[np.float64]
# For how many frames each hand has not been seen.
Unseen = Mapping[str, int]


@dataclass(frozen=True, eq=False)
class Frame:
    """Where one frame ended.

    Attributes
    ----------
    x : (n,) float64
    judgement : Judgement
    unseen : mapping of side to int
        For how many frames each hand has not been seen, this one included.
    report : dict
        JSON types.
    """

    x: Array
    judgement: Judgement
    unseen: Unseen
    report: dict[str, Any]

    @property
    def lost(self) -> bool:
        """Whether there is nothing to go on from."""
        return is_lost(self.judgement.verdict, self.judgement.text)


def is_lost(verdict: str, reason: str) -> bool:
    """Whether a fit missed more than a hand or a finger."""
    kind, _, parts = reason.rstrip(")").partition("(")
    if kind == "part_missed":
        return not all("hand" in part for part in parts.split(", "))
    return verdict == "fail" and kind != "finger_missed"


@dataclass(frozen=True, eq=False)
class Place:
    """Where a sequence stands between two frames: all that the next one needs to know.

    Attributes
    ----------
    x : (n,) or None
        The last frame's parameters; None: no frame could be fitted yet.
    motion : (n,)
        How they moved.
    unseen : mapping of side to int
    betas : (nb,) or None
        The subject's; None: not known yet.
    freeze : bool
        Take the betas of the first frame that can be fitted.
    cold : bool
        Whether the given start has been used up.
    hand : "left", "right" or None
        The side that was found.
    offset : (V, 3) or None
        Of the subject's template.
    """

    x: Array | None
    motion: Array
    unseen: Unseen
    betas: Array | None
    freeze: bool
    cold: bool
    hand: str | None
    offset: Array | None


class Follower(Protocol):
    """Fits one subject frame by frame."""

    @property
    def surface(self) -> Surface:
        """Of the vectors that frames are."""

    @property
    def sides(self) -> tuple[str, ...]:
        """Hands that may be missing."""

    def scan(self, points: Any, normals: Any) -> Scan | Finding:
        """Prepare a frame, or say that it has too few points."""

    def inspect(self, scan: Scan) -> Finding | None:
        """Say what is wrong with a scan that could not be fitted, if it is the scan."""

    def begin(self, points: Any, normals: Any, start: Any) -> Fit:
        """Fit a frame that nothing is known of but ``start``."""

    def vector(self, fit: Fit) -> Array:
        """Return a fit's parameters (n,)."""

    def fitted(self, x: Array, judgement: Judgement, report: dict[str, Any]) -> Fit:
        """Return parameters (n,) as a result."""

    def freed(self, x: Array, scan: Scan) -> Array:
        """Return the mesh (V, 3) of the coupled stage at parameters (n,)."""

    def aligned(self, fit: Fit, scan: Scan) -> Aligned:
        """Free the mesh of a fit of ``surface`` from its model, for the subject's template."""

    @property
    def share(self) -> Array | None:
        """How much of a template's offset each vertex takes (V,); None: all."""

    @property
    def found(self) -> str | None:
        """Side of the hand that is followed, once it is known."""

    def recall(self, hand: str | None, offset: Array | None) -> None:
        """Follow that side, and from now on a template with an offset (V, 3)."""

    def hand(self, side: str) -> NDArray[np.int64]:
        """Return the parameters that are a hand's alone."""

    def follow(
        self, scan: Scan, previous: Array, start: Array, unseen: Unseen, *, shape_free: bool
    ) -> Frame:
        """Fit the next frame.

        Parameters
        ----------
        scan : Scan
        previous : (n,)
            The frame before, which the velocity prior holds to.
        start : (n,)
            Where to begin.
        unseen : mapping of side to int
            Before this frame.
        shape_free : bool
            Also fit the betas (first frames of a subject).
        """
