"""From a scan of a whole body to one finished vector: starts, stages, hands begun afresh."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models.joints import SIDES
from synthgen.registration import body_schedule as schedule
from synthgen.registration.body_arms import arm_begun_afresh
from synthgen.registration.body_hands import begun_afresh
from synthgen.registration.body_prior import BodyPriors
from synthgen.registration.body_schedule import (
    BodyStage,
    basis_of,
    hand_crops,
    logged,
    run_body_stage,
    shape_basis,
)
from synthgen.registration.body_start import starts
from synthgen.registration.body_surface import BodySurface
from synthgen.registration.scan import Scan
from synthgen.registration.schedule import last_stage, own_noise
from synthgen.registration.solver import Outcome
from synthgen.registration.terms import Term

Array = NDArray[np.float64]
KEPT, REFINED_AGAIN = 2, 16


@dataclass
class BodySearch:
    """A search in progress on one scan; ``stages`` and ``seconds`` are for the report.

    ``noise_m`` is the scan's own about the fit, which the last stages believe.
    """

    priors: BodyPriors
    scan: Scan
    extra: Sequence[Term] = ()
    stages: list[dict[str, Any]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    noise_m: float = schedule.LAST.noise_m

    @property
    def surface(self) -> BodySurface:
        """The body's surface."""
        return self.priors.surface

    def stage(
        self,
        x: Array,
        stage: BodyStage,
        crops: Sequence[NDArray[np.int64]] = (),
        others: Scan | None = None,
    ) -> Outcome:
        """Run one stage from x and remember it."""
        began = time.process_time()
        terms = [*self._priors(stage), *self.extra]
        basis = basis_of(self.priors, stage)
        outcome = run_body_stage(self.surface, self.scan, x, stage, terms, basis, crops, others)
        self.stages.append(logged(stage, outcome, time.process_time() - began))
        return outcome

    def _priors(self, stage: BodyStage) -> list[Term]:
        return self.priors.terms() if stage.free != "rigid" else self.priors.coefficient_terms()

    def cold(self, turns: Sequence[float]) -> Array:
        """Return the best vector of several turns about the vertical, hands not yet looked at."""
        began = time.process_time()
        loose = []
        for x in starts(self.priors, self.scan, turns):
            rigid = self.stage(x, schedule.RIGID)
            loose.append(self.stage(rigid.x, schedule.LOOSE))
        loose.sort(key=lambda outcome: outcome.trial.cost)
        wide = [self.stage(o.x, schedule.WIDE) for o in loose[:KEPT]]
        self._spent("start", began)
        return min(wide, key=lambda outcome: outcome.trial.cost).x

    def finish(self, x: Array) -> Outcome:
        """Run the stages that look at hands too, from a rough placement."""
        began = time.process_time()
        crops = hand_crops(self.surface.at(x), self.scan)
        close = self.stage(x, schedule.CLOSE, crops)
        self._spent("finish", began)
        began = time.process_time()
        x = close.x
        for side in SIDES:
            x = self._arm(x, side)
        self._spent("arms", began)
        began = time.process_time()
        for side in SIDES:
            x = self.restarted(x, side)
        self._spent("hands", began)
        return self.refine(x)

    def refine(self, x: Array) -> Outcome:
        """Run the last stages."""
        began = time.process_time()
        crops = hand_crops(self.surface.at(x), self.scan)
        near = self.stage(x, schedule.NEAR, crops)
        fine = self.stage(near.x, schedule.FINE, crops)
        self.noise_m = own_noise(fine, min(schedule.FINE.points, len(self.scan.points)))
        others = schedule.without_hands(self.surface.at(fine.x), self.scan)
        x = fine.x if others is None else self.shaped(fine.x, others)
        outcome = self.stage(x, last_stage(schedule.LAST, self.noise_m), crops, others)
        self._spent("finish", began)
        return outcome

    def shaped(self, x: Array, others: Scan) -> Array:
        """Fit the shape to the points that are no hand's, fingers and wrists held.

        Hands are scanned worse than the rest: smoothed, they would make the whole body thin.
        """
        stage = last_stage(schedule.SHAPE, self.noise_m)
        terms = [*self.priors.terms(), *self.extra]
        return run_body_stage(self.surface, others, x, stage, terms, shape_basis(self.priors)).x

    def again(self, x: Array, sides: Sequence[str]) -> Outcome:
        """Search some hands once more and longer, the rest of the body being in its place."""
        began = time.process_time()
        for side in sides:
            x = begun_afresh(self.priors, self.scan, x, side, REFINED_AGAIN)
        self._spent("hands", began)
        return self.refine(x)

    def arms_again(self, x: Array, sides: Sequence[str]) -> Outcome:
        """Search some arms among the points that the rest of the body leaves, then their hands."""
        began = time.process_time()
        for side in sides:
            x = self.restarted(self._arm(x, side, surely=True), side)
        self._spent("arms", began)
        return self.refine(x)

    def _arm(self, x: Array, side: str, *, surely: bool = False) -> Array:
        return arm_begun_afresh(self.priors, self.scan, x, side, surely=surely)

    def restarted(self, x: Array, side: str) -> Array:
        """Begin one hand afresh; see :func:`synthgen.registration.body_hands.begun_afresh`."""
        return begun_afresh(self.priors, self.scan, x, side)

    def _spent(self, what: str, began: float) -> None:
        self.seconds[what] = self.seconds.get(what, 0.0) + time.process_time() - began
