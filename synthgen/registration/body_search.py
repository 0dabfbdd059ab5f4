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
from synthgen.registration.body_prior import PCA, BodyPriors
from synthgen.registration.body_schedule import (
    BodyStage,
    basis_of,
    body_terms,
    hand_crops,
    hand_vertices,
    logged,
    run_body_stage,
)
from synthgen.registration.body_start import starts
from synthgen.registration.body_surface import BodyPlaced, BodySurface
from synthgen.registration.scan import Scan, nearest
from synthgen.registration.solver import Energy, Outcome, minimise
from synthgen.registration.terms import Term

Array = NDArray[np.float64]
KEPT, REFINED, FEW_POINTS = 2, 3, 40
HAND_SHARE = 0.3


@dataclass
class BodySearch:
    """A search in progress on one scan; ``stages`` and ``seconds`` are for the report."""

    priors: BodyPriors
    scan: Scan
    extra: Sequence[Term] = ()
    stages: list[dict[str, Any]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def surface(self) -> BodySurface:
        """The body's surface."""
        return self.priors.surface

    def stage(self, x: Array, stage: BodyStage, crops: Sequence[NDArray[np.int64]] = ()) -> Outcome:
        """Run one stage from x and remember it."""
        began = time.process_time()
        terms = [*self._priors(stage), *self.extra]
        basis = basis_of(self.priors, stage)
        outcome = run_body_stage(self.surface, self.scan, x, stage, terms, basis, crops)
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
            x = self.restarted(x, side)
        self._spent("hands", began)
        began = time.process_time()
        crops = hand_crops(self.surface.at(x), self.scan)
        for stage in (schedule.NEAR, schedule.FINE, schedule.LAST):
            outcome = self.stage(x, stage, crops)
            x = outcome.x
        self._spent("finish", began)
        return outcome

    def restarted(self, x: Array, side: str) -> Array:
        """Try the mixture's means for one hand; keep the best of the few that are refined."""
        hand = _Hand(self, x, side)
        if len(hand.crop) < FEW_POINTS:
            return x
        tried = []
        for pose in self.priors.hands[side].typical:
            other = x.copy()
            other[self.surface.hands[side]] = pose
            tried.append(other)
        tried.sort(key=hand.cost)
        ends = [hand.refined(y) for y in [x, *tried[:REFINED]]]
        return min(ends, key=hand.cost)

    def _spent(self, what: str, began: float) -> None:
        self.seconds[what] = self.seconds.get(what, 0.0) + time.process_time() - began


class _Hand:
    """The energy of one hand: points near it, its pose and its wrist; everything else stays."""

    def __init__(self, search: BodySearch, x: Array, side: str) -> None:
        self.search, surface = search, search.surface
        self.vertices = hand_vertices(surface, side)
        stage = schedule.HAND
        self.crop = self._own_points(surface.at(x), side)[: stage.hand_points]
        wrist = surface.joint(f"{side}_wrist")
        self.basis = np.zeros((surface.n, 3 + PCA))
        self.basis[wrist, :3] = np.eye(3)
        self.basis[surface.hands[side], 3:] = search.priors.hands[side].components
        priors = [*search.priors.pose_terms(), *search.priors.hand_terms((side,))]
        self.energy = Energy(surface, body_terms(surface, search.scan, stage, priors, (self.crop,)))
        self.weight = HAND_SHARE * stage.n_eff / stage.noise_m**2
        self.s2 = stage.sigma_m**2
        self.iterations = stage.iterations

    def _own_points(self, placed: BodyPlaced, side: str) -> NDArray[np.int64]:
        """Points of the crop that are nearer to the hand or its forearm than to other skin."""
        surface, scan = self.search.surface, self.search.scan
        crop = hand_crops(placed, scan, 0.08)[SIDES.index(side)]
        joint = surface.model.joint_names.index(f"{side}_elbow")
        own = surface.model.weights.argmax(axis=1) == joint
        own[self.vertices] = True
        _, near = nearest(placed.tree, scan.points[crop])
        return np.asarray(crop[own[near]])

    def cost(self, x: Array) -> float:
        """Return the energy, and how far the hand's skin is from the scan."""
        trial = self.energy.at(x)
        distance, _ = nearest(self.search.scan.tree, trial.placed.vertices[self.vertices[::3]])
        squared = distance**2
        return trial.cost + self.weight * float(np.mean(self.s2 * squared / (self.s2 + squared)))

    def refined(self, x: Array) -> Array:
        """Lower the energy of hand and wrist."""
        return minimise(
            self.energy, x, iterations=self.iterations, basis=self.basis, damping=1e-3
        ).x
