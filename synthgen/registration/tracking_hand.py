"""One frame of a tracked hand: the finishing stages of a hand's fit, shape held (Eq. 21)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models import BodyModel, ManoModel, mirror_model, mirror_pose
from synthgen.registration.coarse_model import coarse_model_of
from synthgen.registration.coupled import couple
from synthgen.registration.fit import fit
from synthgen.registration.fitted import Fit, Side
from synthgen.registration.initialiser import initialiser_of
from synthgen.registration.inspection import LEAST_POINTS, Finding, inspect
from synthgen.registration.limit_term import LimitPrior
from synthgen.registration.prior import learned_prior
from synthgen.registration.scan import Scan, checked_points, scan_of
from synthgen.registration.schedule import preset_named
from synthgen.registration.search import Search, Settings
from synthgen.registration.surface import Surface, surface_of
from synthgen.registration.template import Aligned, with_offset
from synthgen.registration.terms import Term, velocity_prior
from synthgen.registration.tracked import Frame, Unseen, is_lost
from synthgen.registration.verdict import Judgement
from synthgen.sampling.limits import limits_of

Array = NDArray[np.float64]
# A hand alone is seen at close range: it moves faster from frame to frame than on a body.
STEP_RAD = np.deg2rad(4.0)
_FLIP = np.array([-1.0, 1.0, 1.0])


class HandFollower:
    """Follows a hand; see :class:`synthgen.registration.tracked.Follower`.

    Vectors are those of the right hand; a left hand's scans are mirrored.
    """

    sides: tuple[str, ...] = ("hand",)

    def __init__(self, model: BodyModel, hand: str | None, seed: int = 0) -> None:
        if not isinstance(model, ManoModel):
            raise ModelError(f"model {model.name!r} is no hand in MANO form")
        self.model = mirror_model(model) if model.hand == "left" else model
        self.surface: Surface = surface_of(self.model)
        self.asked, self.seed = hand, seed
        self.side: Side = "left" if hand == "left" else "right"

    def scan(self, points: Any, normals: Any) -> Scan | Finding:
        """Shuffle the points, or say that there are too few."""
        own, given, _ = checked_points(points, normals)
        if len(own) < LEAST_POINTS:
            return Finding("no_points", f"{len(own)} finite points; a scan has thousands")
        return scan_of(own, given, seed=self.seed)

    def inspect(self, scan: Scan) -> Finding | None:
        """Say what is wrong with a scan that could not be fitted, if it is the scan."""
        return inspect(scan, check_normals=True)

    def begin(self, points: Any, normals: Any, start: Any) -> Fit:
        """Fit the first frame, which tells the side."""
        found = fit(points, normals, self.model, start, self.asked, seed=self.seed)
        if not is_lost(found.verdict, found.reason):
            assert found.hand is not None
            self.side = self.asked = found.hand
        return found

    def vector(self, fit: Fit) -> Array:
        """Return a fit's parameters, as a right hand's."""
        if fit.hand == "right":
            return self.surface.pack(fit.shape, fit.pose, fit.translation)
        return self.surface.pack(fit.shape, mirror_pose(fit.pose), fit.translation * _FLIP)

    def fitted(self, x: Array, judgement: Judgement, report: dict[str, Any]) -> Fit:
        """Return a vector as a result, on the hand's own side."""
        shape, pose, translation = self.surface.unpack(x)
        placed = self.surface.at(x)
        left = self.side == "left"
        flip = _FLIP if left else np.ones(3)
        return Fit(
            shape=shape,
            pose=mirror_pose(pose) if left else pose,
            translation=translation * flip,
            hand=self.side,
            vertices=placed.vertices * flip,
            joints=placed.joints * flip,
            verdict=judgement.verdict,
            reason=judgement.text,
            report={**report, "hand": self.side},
            model=mirror_model(self.surface.model) if left else self.surface.model,
        )

    def freed(self, x: Array, scan: Scan) -> Array:
        """Free the mesh from the model, on the hand's own side."""
        own = scan if self.side == "right" else scan.mirrored()
        priors = self._settings(x, 0, shape_free=True).priors(1.0)
        free = couple(self.surface, own, x, priors).vertices
        return free if self.side == "right" else free * _FLIP

    def aligned(self, fit: Fit, scan: Scan) -> Aligned:
        """Free the mesh of a frame from the model, as a right hand."""
        own, x = scan if self.side == "right" else scan.mirrored(), self.vector(fit)
        priors = self._settings(x, 0, shape_free=True).priors(1.0)
        found = couple(self.surface, own, x, priors)
        return Aligned(*self.surface.unpack(found.x), found.vertices, found.seen)

    @property
    def share(self) -> None:
        """All of the offset."""
        return None

    @property
    def found(self) -> str | None:
        """The side, once a frame has told it."""
        return self.asked if self.asked in ("left", "right") else None

    def recall(self, hand: str | None, offset: Array | None) -> None:
        """Follow that side, and from now on the model with an offset (V, 3), as a right hand."""
        if hand is not None:
            self.asked = hand
            self.side = "left" if hand == "left" else "right"
        if offset is not None:
            self.surface = surface_of(with_offset(self.model, offset))

    def hand(self, side: str) -> NDArray[np.int64]:
        """Return all angles."""
        return np.arange(self.surface.pose.start, self.surface.pose.stop)

    def follow(
        self, scan: Scan, previous: Array, start: Array, unseen: Unseen, *, shape_free: bool
    ) -> Frame:
        """Follow the hand into the next frame."""
        own = scan if self.side == "right" else scan.mirrored()
        search = Search(self._settings(previous, unseen["hand"], shape_free=shape_free), own)
        found = search.run(start[None])
        judgement = found.judgement or Judgement("fail", "not_converged")
        report = {"early_explained": found.early, "stages": found.stages,
                  **({} if found.statistics is None else found.statistics.to_json())}  # fmt: skip
        return Frame(found.x, judgement, {"hand": 0}, report)

    def _settings(self, previous: Array, unseen: int, *, shape_free: bool) -> Settings:
        surface, net = self.surface, initialiser_of(self.model)
        prior = learned_prior(self.model) if net is None else net.prior
        spread = np.full(45, STEP_RAD * (1 + unseen))
        still = velocity_prior(surface.fingers, previous, spread)
        terms: list[Term] = [LimitPrior(surface.pose, limits_of(self.model)), still]
        moving = np.delete(np.eye(surface.n), np.r_[surface.shape], axis=1)
        return Settings(self.model, surface, prior, coarse_model_of(self.model, prior),
                        preset_named("fast"), terms, None if shape_free else moving,
                        previous)  # fmt: skip
