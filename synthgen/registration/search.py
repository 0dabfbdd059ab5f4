"""From hypotheses to one judged fit: coarse rounds, finishing, re-seeding of single fingers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.models import BodyModel
from synthgen.registration import coarse
from synthgen.registration.begin import beginnings
from synthgen.registration.certainty import covariance
from synthgen.registration.coarse_model import CoarseModel, Single, Starts
from synthgen.registration.patches import patches_of
from synthgen.registration.prior import HandPrior
from synthgen.registration.scan import Scan
from synthgen.registration.schedule import (
    FINAL,
    Preset,
    Stage,
    last_stage,
    own_noise,
    run_stage,
    stage_terms,
)
from synthgen.registration.solver import Energy, Outcome
from synthgen.registration.starts import ranked, reseeded
from synthgen.registration.statistics import Statistics, early_explained, statistics
from synthgen.registration.surface import Surface
from synthgen.registration.terms import MixturePrior, Term, shape_prior
from synthgen.registration.verdict import Judgement, explains_more, judge, misfits
from synthgen.registration.visibility import visible_vertices

Array = NDArray[np.float64]
EARLY, MOST_FINISHES, MOST_RESEEDS, COARSE_POINTS = 0.92, 6, 2, 600
# Within this a point is explained early: 3 mm, with a poor sensor up to 6 mm; the scatter about
# planes of few neighbours is less than half of much noise.
EARLY_M, EARLY_NOISES = (3e-3, 6e-3), 5.0
SAME_M = 5e-4  # two fits nearer than this found the same optimum


@dataclass(frozen=True, eq=False)
class Settings:
    """What stays the same during a fit.

    Attributes
    ----------
    model : BodyModel
        A right hand.
    extra : sequence of Term
        Joint limits, protocol pose, keypoints: whatever the caller adds.
    basis, origin : (n, p) and (n,), or None
        Fits are ``origin + basis z``; None: all n directions.
    curved : float
        See :func:`synthgen.registration.correspondences.closest`.
    """

    model: BodyModel
    surface: Surface
    prior: HandPrior
    coarse: CoarseModel
    preset: Preset
    extra: Sequence[Term] = ()
    basis: Array | None = None
    origin: Array | None = None
    curved: float = 0.0

    def within(self, x: Array) -> Array:
        """Return the vector (n,) nearest to x that a fit may be."""
        if self.basis is None or self.origin is None:
            return x
        z = np.linalg.lstsq(self.basis, x - self.origin, rcond=None)[0]
        return np.asarray(self.origin + self.basis @ z)

    def priors(self, weight: float) -> list[Term]:
        """Pose and shape priors at a weight, and the extra terms."""
        p = self.prior
        pose = MixturePrior(self.surface.fingers, p.means, p.whiten, p.constants, weight)
        return [pose, shape_prior(self.surface), *self.extra]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A finished fit of one start.

    Attributes
    ----------
    x : (n,) float64
    source : str
        ``c0`` the best coarse result, ``r1`` from the first re-seeding, ``given`` a given start.
    early : float
        Share explained within 3 mm after the first stage; low ones are dropped there.
    statistics, judgement : None if dropped early
    stages : list of dict
        Steps, stop reason and CPU seconds of each stage.
    """

    x: Array
    source: str
    early: float
    statistics: Statistics | None = None
    judgement: Judgement | None = None
    stages: list[dict[str, Any]] = field(default_factory=list)

    @property
    def accepted(self) -> bool:
        """Whether the verdict is pass or unobserved."""
        return self.judgement is not None and self.judgement.verdict != "fail"

    @property
    def rank(self) -> tuple[float, float]:
        """Larger is better."""
        if self.statistics is None:
            return (0.0, self.early)
        return (1.0 + self.accepted, self.statistics.explained)

    @property
    def settled(self) -> bool:
        """Whether it is accepted, and not only because what misfits is judged leniently."""
        s = self.statistics
        passes = self.judgement is not None and self.judgement.verdict == "pass"
        return self.accepted and s is not None and (passes or not misfits(s))

    def beats(self, other: Candidate) -> bool:
        """Tell whether one side's best fit is better than the other side's."""
        if self.accepted and not self.settled and not other.accepted:
            return not explains_more(other.statistics, self.statistics)
        if other.accepted and not other.settled and not self.accepted:
            return explains_more(self.statistics, other.statistics)
        return self.rank > other.rank


@dataclass
class Search:
    """A search in progress on one scan; ``candidates`` are all that were finished."""

    settings: Settings
    scan: Scan
    candidates: list[Candidate] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.points: Single = self.scan.points[:COARSE_POINTS].astype(np.float32)
        self.normals: Single = self.scan.normals[:COARSE_POINTS].astype(np.float32)

    def coarse(self, starts: Starts) -> tuple[Array, Single]:
        """Run the coarse rounds; vectors and energies, best first."""
        began = time.process_time()
        model = self.settings.coarse
        kept = ranked(model, starts, self.points, self.normals)
        found, energy = coarse.run(model, kept, self.points, self.normals, coarse.COLD)
        self._spent("coarse", began)
        return model.to_vectors(found), energy

    def explained(self, x: Array) -> float:
        """Share of the scan that a vector explains as it is."""
        return early_explained(self.settings.surface.at(x), self.scan, _early_limit_m(self.scan))

    def finish(self, x: Array, source: str) -> Candidate:
        """Run the finishing stages of one vector, judge it and remember it."""
        began = time.process_time()
        candidate = finish(self.settings, self.scan, x, source)
        self.candidates.append(candidate)
        self._spent("finish", began)
        return candidate

    def run(self, vectors: Array, source: str = "c") -> Candidate:
        """Finish vectors in order until one is accepted; re-seed fingers of the failures."""
        queue = [(x, f"{source}{k}") for k, x in enumerate(vectors[:3])]
        reseeds = 0
        while queue and len(self.candidates) < MOST_FINISHES:
            x, name = queue.pop(0)
            before = list(self.candidates)
            found = self.finish(x, name)
            if found.accepted:
                break
            if name.startswith("r") and any(self._same(found, c) for c in before):
                break  # other fingers led to the same fit: it is what this start has to give
            if reseeds < MOST_RESEEDS and (name.endswith("0") or name.startswith("r")):
                reseeds += 1
                queue = [(y, f"r{reseeds}") for y in self.reseed()[:2]] + queue
        return self.best

    def reseed(self) -> Array:
        """Try typical poses of every single finger of the best candidate so far."""
        began = time.process_time()
        model = self.settings.coarse
        starts = reseeded(model, self.best.x, self.settings.prior.fingers)
        found, _ = coarse.run(model, starts, self.points, self.normals, coarse.RESEED, 7e-4)
        self._spent("reseed", began)
        return model.to_vectors(found)

    def _same(self, a: Candidate, b: Candidate) -> bool:
        if a.statistics is None or b.statistics is None:
            return False
        surface = self.settings.surface
        off = surface.at(a.x).vertices - surface.at(b.x).vertices
        return float(np.linalg.norm(off, axis=1).mean()) < SAME_M

    @property
    def best(self) -> Candidate:
        """The best candidate so far."""
        return max(self.candidates, key=lambda c: c.rank)

    def _spent(self, what: str, began: float) -> None:
        self.seconds[what] = self.seconds.get(what, 0.0) + time.process_time() - began


def finish(settings: Settings, scan: Scan, x: Array, source: str) -> Candidate:
    """Run the finishing stages; give up after the first if it explains too little."""
    log: list[dict[str, Any]] = []
    x, noise, inflation = settings.within(x), None, 1.0
    outcome: Outcome | None = None
    for k, stage in enumerate(settings.preset.finish):
        if settings.preset.own_noise and noise is not None and stage.points >= FINAL.points:
            stage = last_stage(stage, noise)
            stage = replace(stage, n_eff=stage.n_eff / inflation)
        began = time.process_time()
        visible = None
        if scan.viewpoints is not None and stage.mesh_to_scan > 0:
            visible = visible_vertices(settings.surface.at(x), scan.viewpoints)
        outcome = run_stage(
            settings.surface, scan, x, stage, settings.priors(stage.prior),
            method=settings.preset.method, basis=settings.basis, visible=visible,
            curved=settings.curved, begin=_begin(scan, stage, outcome),
        )  # fmt: skip
        x = outcome.x
        log.append(_logged(stage, outcome, began))
        if k == 0:
            early = early_explained(outcome.trial.placed, scan, _early_limit_m(scan))
            if early < EARLY:
                return Candidate(x, source, early, stages=log)
        noise = own_noise(outcome)
        if stage.points >= FINAL.points and k + 1 < len(settings.preset.finish):
            inflation = _inflation(scan, outcome, settings.preset.finish[k + 1], noise)
    assert outcome is not None
    energy = Energy(settings.surface, stage_terms(scan, stage, settings.priors(1.0)))
    step, pending = _pending(energy, outcome, settings.basis)
    spread = covariance(energy, outcome.trial, together=inflation) + np.outer(step, step)
    found = statistics(
        outcome.trial.placed, scan, spread, settings.curved, inflation, outcome.trial.matches[0],
        pending,
    )  # fmt: skip
    verdict = judge(found, x[settings.surface.shape])
    return Candidate(x, source, early, found, verdict, log)


def _early_limit_m(scan: Scan) -> float:
    return float(np.clip(EARLY_NOISES * scan.local_noise_m, *EARLY_M))


def _begin(scan: Scan, stage: Stage, before: Outcome | None) -> NDArray[np.int64] | None:
    """Where a stage of many points begins to match: at its neighbours' matches of the last one."""
    if before is None or stage.points < FINAL.points:
        return None
    points, normals = scan.points[: stage.points], scan.normals[: stage.points]
    return beginnings(points, normals, before.trial.matches[0])


def _inflation(scan: Scan, outcome: Outcome, following: Stage, noise_m: float) -> float:
    """Return how many times too sure of itself the next stage would be, if the model misfits."""
    pairs = outcome.trial.matches[0]
    n = len(pairs.squared)
    found = patches_of(outcome.trial.placed, pairs, scan.points[:n], scan.normals[:n], noise_m)
    counted = following.counted(len(scan.points))
    return counted / found.effective(counted)


def _pending(energy: Energy, outcome: Outcome, basis: Array | None) -> tuple[Array, float]:
    """Return the step (n,) that is left, and the share of the energy that it promises to remove.

    Only along the free directions: a fit of few components does not want the others.
    """
    free = np.eye(energy.surface.n) if basis is None else basis
    hessian, gradient = energy.normal_equations(outcome.trial)
    hessian, gradient = free.T @ hessian @ free, free.T @ gradient
    ridge = 1e-12 * np.trace(hessian) / len(hessian) * np.eye(len(hessian))
    step = np.linalg.solve(hessian + ridge, gradient)
    return free @ step, float(gradient @ step) / max(outcome.trial.cost, 1e-9)


def _logged(stage: Stage, outcome: Outcome, began: float) -> dict[str, Any]:
    return {
        "points": stage.points,
        "sigma_mm": 1e3 * stage.sigma_m,
        "steps": outcome.iterations,
        "stopped": outcome.reason,
        "cost": outcome.trial.cost,
        "cpu_s": time.process_time() - began,
    }
