"""One frame of a tracked body: from the pose of the frame before to this scan's (Eq. 21-23).

The shape stays, no pose is preferred, every angle moves by about two degrees; hands have priors of
their own. A hand of which too few points are there is held: its fingers and wrist keep their
angles, and when it is seen again it may have moved as far as the frames without it allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.models import BodyModel
from synthgen.models.joints import SIDES
from synthgen.registration.body_fit import as_fit, body_scan, body_surface, fit_body
from synthgen.registration.body_prior import body_priors
from synthgen.registration.body_schedule import (
    MM,
    SHAPE,
    TREE_POINTS,
    BodyStage,
    basis_of,
    hand_crops,
    hand_vertices,
    run_body_stage,
    without_hands,
)
from synthgen.registration.body_search import BodySearch
from synthgen.registration.body_surface import BodyPlaced, BodySurface
from synthgen.registration.coupled import BODY as BODY_COUPLING
from synthgen.registration.coupled import couple
from synthgen.registration.fitted import Fit
from synthgen.registration.inspection import BODY, LEAST_POINTS, Finding, inspect
from synthgen.registration.scan import Scan, checked_points, nearest
from synthgen.registration.solver import Outcome
from synthgen.registration.template import Aligned, with_offset
from synthgen.registration.terms import Term, velocity_prior
from synthgen.registration.tracked import Frame, Unseen
from synthgen.registration.tracking_state import BodyState, presence
from synthgen.registration.verdict import Judgement
from synthgen.sampling.streams import stream

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
STAGES = (
    BodyStage(1200, 4, 15 * MM, 60 * MM, 0.2, 3 * MM, 800, 0.05, hand_points=250),
    BodyStage(2500, 3, 5 * MM, 25 * MM, 0.4, 1.5 * MM, 2500, hand_points=500),
    BodyStage(4000, 2, 3 * MM, 12 * MM, 0.5, 1 * MM, 5000, hand_points=800),
)
# A subject's template fades in over so much skin beside the hands.
BLEND_M = 0.05
# Zero-velocity prior: standard deviation of an angle from frame to frame; times as much for a hand
# that was begun afresh.
STEP_RAD, AFRESH = np.deg2rad(2.0), 20.0
# A hand with less than this share of its points is not there.
PRESENT = 0.4


class BodyFollower:
    """Follows a body; see :class:`synthgen.registration.tracked.Follower`."""

    def __init__(self, model: BodyModel, seed: int = 0) -> None:
        self.model = model
        self.surface: BodySurface = body_surface(model)
        self.priors = body_priors(self.surface)
        self.sides: tuple[str, ...] = SIDES
        self.seed = seed

    def scan(self, points: Any, normals: Any) -> Scan | Finding:
        """Take some 40,000 points in random order, or say that there are too few."""
        own, given, _ = checked_points(points, normals)
        if len(own) > TREE_POINTS:
            rng = stream(self.seed, "corpus", 0, 0, "scan points")
            some = rng.choice(len(own), TREE_POINTS, replace=False)
            own, given = own[some], None if given is None else given[some]
        if len(own) < LEAST_POINTS:
            return Finding("no_points", f"{len(own)} finite points; a scan has thousands")
        return body_scan(own, given, seed=self.seed)

    def inspect(self, scan: Scan) -> Finding | None:
        """Say what is wrong with a scan that could not be fitted, if it is the scan."""
        return inspect(scan, check_normals=True, expected=BODY)

    def begin(self, points: Any, normals: Any, start: Any) -> Fit:
        """Fit the first frame."""
        return fit_body(points, normals, self.model, start, seed=self.seed)

    def vector(self, fit: Fit) -> Array:
        """Return a fit's parameters."""
        x = self.surface.pack(fit.shape, fit.pose, fit.translation)
        if fit.expression is not None:
            x[self.surface.expression] = fit.expression
        return x

    def fitted(self, x: Array, judgement: Judgement, report: dict[str, Any]) -> Fit:
        """Return a vector as a result."""
        return as_fit(self.surface.at(x), judgement, report)

    def freed(self, x: Array, scan: Scan) -> Array:
        """Free the mesh from the model."""
        return couple(self.surface, scan, x, (), settings=BODY_COUPLING).vertices

    def aligned(self, fit: Fit, scan: Scan) -> Aligned:
        """Free the mesh of a frame from the model."""
        found = couple(self.surface, scan, self.vector(fit), (), settings=BODY_COUPLING)
        return Aligned(fit.shape, fit.pose, fit.translation, found.vertices, found.seen,
                       fit.expression)  # fmt: skip

    @property
    def share(self) -> Array:
        """All of the offset but on hands, which are scanned worse than the rest."""
        rest = self.surface.model.v_template
        hands = np.concatenate([hand_vertices(self.surface, side) for side in SIDES])
        away = nearest(cKDTree(rest[hands]), rest)[0]
        return np.clip(away / BLEND_M, 0, 1)

    @property
    def found(self) -> None:
        """Bodies have no side."""
        return None

    def recall(self, hand: str | None, offset: Array | None) -> None:
        """From now on follow the model with an offset (V, 3)."""
        if offset is not None:
            self.surface = body_surface(with_offset(self.model, offset))
            self.priors = replace(self.priors, surface=self.surface)

    def hand(self, side: str) -> Ids:
        """Parameters of a hand: fingers and wrist."""
        s = self.surface
        return np.concatenate([np.r_[s.hands[side]], np.r_[s.joint(f"{side}_wrist")]])

    def follow(
        self, scan: Scan, previous: Array, start: Array, unseen: Unseen, *, shape_free: bool
    ) -> Frame:
        """Follow the body into the next frame."""
        run = _Run(self, scan, previous, unseen, shape_free)
        placed = self.surface.at(start.copy())
        run.look(placed)
        placed = run.stage(placed.x, STAGES[0])
        run.look(placed)
        placed = run.stages(placed.x)
        state = BodyState.of(placed, scan)
        missed = state.missed(run.seen)
        if missed:
            other = run.begun_afresh(placed, missed)
            found = BodyState.of(other, scan)
            missed = found.better(state, missed)
            if missed:
                placed, state = other, found
        gone = {side: 0 if side in run.seen else unseen[side] + 1 for side in SIDES}
        report = {**state.to_json(), "begun_afresh": list(missed), "steps": run.steps}
        return Frame(placed.x, state.judged(gone), gone, report)


class _Run:
    """A frame in progress: which hands are there, and what may move."""

    def __init__(
        self, body: BodyFollower, scan: Scan, previous: Array, unseen: Unseen, shape_free: bool
    ) -> None:
        self.body, self.scan, self.previous, self.unseen = body, scan, previous, unseen
        self.betas = None if shape_free else 0
        self.seen: tuple[str, ...] = SIDES
        self.afresh: tuple[str, ...] = ()
        self.crops: list[Ids] = []
        self.steps = 0

    def look(self, placed: BodyPlaced) -> None:
        """Find the hands' points, and which hands are there; the others return to their hold."""
        crops = hand_crops(placed, self.scan)
        share = presence(placed, self.scan, crops)
        self.seen = tuple(s for s in SIDES if share[s] >= PRESENT)
        self.crops = [c for s, c in zip(SIDES, crops, strict=True) if s in self.seen]
        for side in SIDES:
            if side not in self.seen:
                held = self.body.hand(side)
                placed.x[held] = self.previous[held]

    def stage(self, x: Array, stage: BodyStage) -> BodyPlaced:
        """Run one stage with the hands that are there."""
        priors, surface = self.body.priors, self.body.surface
        basis = basis_of(priors, replace(stage, betas=self.betas))
        for side in SIDES:
            if side not in self.seen:
                basis = basis[:, ~basis[self.body.hand(side)].any(axis=0)]
        outcome: Outcome = run_body_stage(
            surface, self.scan, x, stage, self._terms(), basis, self.crops
        )
        self.steps += outcome.iterations
        placed = outcome.trial.placed
        assert isinstance(placed, BodyPlaced)
        return placed

    def stages(self, x: Array) -> BodyPlaced:
        """Run the stages after the first, and last the shape's."""
        for stage in STAGES[1:]:
            placed = self.stage(x, stage)
            x = placed.x
        if self.betas is None:
            placed = self._shaped(x)
        return placed

    def _shaped(self, x: Array) -> BodyPlaced:
        """Fit the shape to the points that are no hand's, fingers and wrists held."""
        kept = self.scan, self.crops, self.seen
        others = without_hands(self.body.surface.at(x), self.scan)
        if others is None:
            return self.body.surface.at(x)
        self.scan = others
        self.crops, self.seen = [], ()
        placed = self.stage(x, SHAPE)
        self.scan, self.crops, self.seen = kept
        return placed

    def _terms(self) -> list[Term]:
        priors = self.body.priors
        terms = [*priors.hand_terms(self.seen), self._velocity()]
        free = self.betas is None or priors.surface.model.n_expression > 0
        return [*terms, *priors.coefficient_terms()] if free else terms

    def _velocity(self) -> Term:
        """Zero-velocity term (Eq. 21) of the joints and the hands; the root is free."""
        s = self.body.surface
        sd = np.full(s.n, STEP_RAD)
        for side in self.seen:
            sd[self.body.hand(side)] *= AFRESH if side in self.afresh else 1 + self.unseen[side]
        ids = np.concatenate([self.body.priors.joints, *(np.r_[s.hands[k]] for k in self.seen)])
        return velocity_prior(ids, self.previous, sd[ids])

    def begun_afresh(self, placed: BodyPlaced, sides: Sequence[str]) -> BodyPlaced:
        """Try typical poses for hands that fit badly; the frame before no longer binds them."""
        x = placed.x
        search = BodySearch(self.body.priors, self.scan)
        for side in sides:
            x = search.restarted(x, side)
        self.afresh = tuple(sides)
        crops = hand_crops(self.body.surface.at(x), self.scan)
        self.crops = [c for s, c in zip(SIDES, crops, strict=True) if s in self.seen]
        return self.stages(x)
