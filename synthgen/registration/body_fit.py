"""Fitting a body to a scan: what :func:`synthgen.registration.fit` does for bodies."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError, ShapeError
from synthgen.models import BodyModel
from synthgen.models.joints import SIDES
from synthgen.registration import body_schedule as schedule
from synthgen.registration.body_prior import BodyPriors, body_priors
from synthgen.registration.body_search import BodySearch
from synthgen.registration.body_start import spread_yaws, yaws
from synthgen.registration.body_statistics import BodyStatistics, body_statistics, judge_body
from synthgen.registration.body_surface import BodyPlaced, BodySurface
from synthgen.registration.certainty import Earlier, covariance
from synthgen.registration.coupled import BODY as BODY_COUPLING
from synthgen.registration.coupled import couple
from synthgen.registration.fitted import Fit
from synthgen.registration.inspection import BODY, Finding, inspect
from synthgen.registration.scan import Scan, checked_points, scan_of
from synthgen.registration.schedule import last_stage
from synthgen.registration.solver import Energy, Outcome
from synthgen.registration.surface import surface_of
from synthgen.registration.terms import GaussianPrior, KeypointTerm, Term
from synthgen.registration.verdict import Judgement

Array = NDArray[np.float64]
# Estimating normals costs more than the fit; fewer points would be coarser than fingers.
ESTIMATED = 150_000
# Scans of hands are smoothed and webbed: so many of their points err as one. Error over prediction
# of hands at 0.2 / 1.0 mm, if it were 1, 2, 3: 1.20 / 1.16, 1.05 / 0.99, 0.94 / 0.88.
HAND_TOGETHER = 2.0


@dataclass(frozen=True, eq=False)
class BodyCandidate:
    """A finished fit of one start, with what it says about itself."""

    placed: BodyPlaced
    statistics: BodyStatistics
    judgement: Judgement

    @property
    def rank(self) -> tuple[bool, float]:
        """Larger is better."""
        s = self.statistics
        return self.judgement.verdict != "fail", s.explained - float(np.nansum(s.unexplained))

    @property
    def missed_hands(self) -> list[str]:
        """Sides whose hands alone are badly explained; empty if more of the body is."""
        parts = self._missed
        return [side for side, kind in parts] if all(p[1] == "hand" for p in parts) else []

    @property
    def missed_arms(self) -> list[str]:
        """Sides whose arms are badly explained, whatever else is."""
        return [side for side, kind in self._missed if kind == "arm"]

    @property
    def _missed(self) -> list[tuple[str, str]]:
        """Side and kind of the parts that are badly explained."""
        if self.judgement.reason != "part_missed":
            return []
        parts = [part.partition("_") for part in self.judgement.parts]
        return [(side, kind) for side, _, kind in parts]


def fit_body(
    points: Any,
    normals: Any,
    model: BodyModel,
    start: str | tuple[Any, ...],
    *,
    coupled: bool = False,
    viewpoints: Any = None,
    keypoints: tuple[Any, Any] | None = None,
    pose_prior: tuple[Any, float] | None = None,
    seed: int = 0,
) -> Fit:
    """Fit a body; arguments as :func:`synthgen.registration.fit`."""
    surface = body_surface(model)
    priors = body_priors(surface)
    begin = start_vector(surface, start)
    extra = _extra(surface, keypoints, pose_prior)
    own, given, dropped = checked_points(points, normals)
    if len(own) < 20:
        finding = Finding("no_points", f"{len(own)} finite points; a scan has thousands")
        return _refused(priors, finding, dropped)
    scan = body_scan(own, given, viewpoints, seed=seed)
    problem = inspect(scan, check_normals=given is not None, expected=BODY)
    if problem is not None:
        return _refused(priors, problem, dropped)
    began = time.process_time()
    search = BodySearch(priors, scan, extra)
    chosen, kind = _searched(search, begin)
    free = _freed(search, chosen) if coupled and chosen.judgement.verdict != "fail" else None
    found = _result(search, chosen, kind, dropped, time.process_time() - began)
    return replace(found, free_vertices=free)


def body_surface(model: BodyModel) -> BodySurface:
    """Return the surface of a body, made once per process.

    Raises
    ------
    ModelError
        If the model is no whole body with fingers, of SMPL+H or SUPR form.
    """
    surface = surface_of(model)
    if not isinstance(surface, BodySurface) or set(surface.hands) != set(SIDES):
        raise ModelError(
            f"model {model.name!r} is no whole body with two hands; the fitter takes hands and "
            "whole bodies, such as cc0-hand, cc0-body and cc0-supr"
        )
    return surface


def body_scan(
    points: Array, normals: Array | None, viewpoints: Any = None, *, seed: int = 0
) -> Scan:
    """Return a body's scan; without normals it is thinned before they are estimated."""
    if normals is None and len(points) > ESTIMATED:
        points = points[:: -(-len(points) // ESTIMATED)]
    return scan_of(points, normals, viewpoints, seed=seed, wide_m=BODY.wide_m,
                   tree_points=schedule.TREE_POINTS)  # fmt: skip


def start_vector(surface: BodySurface, start: str | tuple[Any, ...]) -> Array | None:
    """Return (shape, pose, translation[, expression]) as a vector, or None when cold.

    Raises
    ------
    ShapeError
        If the start does not fit the model.
    """
    if isinstance(start, str):
        if start != "cold":
            raise ShapeError(f"start={start!r}; expected 'cold' or (shape, pose, translation)")
        return None
    parts = [np.asarray(part, dtype=np.float64) for part in start]
    k, ns, ne = surface.n_joints, surface.model.n_shape, surface.model.n_expression
    shapes = [part.shape for part in parts]
    good = len(parts) in (3, 4) and parts[0].ndim == 1 and len(parts[0]) <= ns
    good = good and parts[1].size == 3 * k and parts[2].size == 3
    if not good or (len(parts) == 4 and parts[3].size > ne):
        raise ShapeError(
            f"start has shapes {shapes}; expected (up to {ns},), ({k}, 3), (3,)"
            + (f" and, if given, (up to {ne},) of expression" if ne else "")
        )
    x = surface.pack(parts[0], parts[1].reshape(-1, 3), parts[2].ravel())
    if len(parts) == 4:
        x[surface.expression.start : surface.expression.start + parts[3].size] = parts[3].ravel()
    if not np.isfinite(x).all():
        raise ShapeError("start holds a number that is not finite")
    return x


def _extra(
    surface: BodySurface,
    keypoints: tuple[Any, Any] | None,
    pose_prior: tuple[Any, float] | None,
) -> list[Term]:
    """Return what the caller knows besides the scan."""
    extra: list[Term] = []
    if keypoints is not None:
        ids, positions = checked_keypoints(keypoints, surface.n_joints)
        extra.append(KeypointTerm(ids, positions, 0.01))
    if pose_prior is not None:
        pose = checked_pose(pose_prior, surface.n_joints).ravel()
        inner = slice(surface.fingers.start, surface.pose.stop)
        extra.append(GaussianPrior(inner, pose[3:], np.full(pose.size - 3, float(pose_prior[1]))))
    return extra


def checked_keypoints(keypoints: tuple[Any, Any], joints: int) -> tuple[NDArray[np.int64], Array]:
    """Return joint numbers (m,) and positions (m, 3), or say what is wrong with them."""
    ids, positions = np.asarray(keypoints[0]), np.asarray(keypoints[1], dtype=np.float64)
    if ids.ndim != 1 or positions.shape != (len(ids), 3):
        raise ShapeError(f"keypoints: ids {ids.shape} for positions {positions.shape}; "
                         "expected (m,) and (m, 3)")  # fmt: skip
    if not np.issubdtype(ids.dtype, np.integer) or ((ids < 0) | (ids >= joints)).any():
        raise ShapeError(f"keypoints: ids {ids.tolist()}; expected joints 0-{joints - 1}")
    if not np.isfinite(positions).all():
        raise ShapeError("keypoints hold a number that is not finite; leave that joint out")
    return ids.astype(np.int64), positions


def checked_pose(pose_prior: tuple[Any, float], joints: int) -> Array:
    """Return the pose (K, 3) of a prior, or say what is wrong with it."""
    pose, sd = np.asarray(pose_prior[0], dtype=np.float64), float(pose_prior[1])
    if pose.size != 3 * joints:
        raise ShapeError(f"pose_prior has {pose.size} numbers; expected {3 * joints}")
    if not np.isfinite(pose).all() or not 0 < sd < np.inf:
        raise ShapeError(f"pose_prior: sd {sd:g} rad; the pose must be finite and its sd above 0")
    return pose.reshape(-1, 3)


def _searched(search: BodySearch, begin: Array | None) -> tuple[BodyCandidate, str]:
    """Fit from the given start, then cold, then from turns all around, until one is accepted."""
    tries: list[tuple[str, Sequence[float] | None]] = [
        ("cold, two turns", yaws(search.scan)), ("cold, eight turns", spread_yaws()),
    ]  # fmt: skip
    if begin is not None:
        tries = [("given", None), *tries]
    best: BodyCandidate | None = None
    kind = ""
    for name, turns in tries:
        if turns is None:
            assert begin is not None
            x = search.stage(begin, schedule.WIDE).x
        else:
            x = search.cold(turns)
        found = judged(search, search.finish(x))
        if best is None or found.rank > best.rank:
            best, kind = found, name
            if sides := best.missed_arms:
                other = judged(search, search.arms_again(best.placed.x, sides))
                if other.rank > best.rank:
                    best, kind = other, f"{name}, arms again"
        if sides := best.missed_hands:
            other = judged(search, search.again(best.placed.x, sides))
            return (other if other.rank > best.rank else best), f"{kind}, hands again"
        if best.judgement.verdict != "fail" or best.judgement.reason == "shape_limit":
            break
    assert best is not None
    return best, kind


def judged(search: BodySearch, outcome: Outcome) -> BodyCandidate:
    """Judge where a search ended."""
    placed = outcome.trial.placed
    assert isinstance(placed, BodyPlaced)
    began = time.process_time()
    found = body_statistics(placed, search.scan, spread(search, placed))
    search.seconds["report"] = time.process_time() - began
    return BodyCandidate(placed, found, judge_body(found, placed.x[search.surface.shape]))


def spread(search: BodySearch, placed: BodyPlaced) -> Array:
    """Return the covariance (n, n) of the parameters at the end of the last stage."""
    priors, stage = search.priors, last_stage(schedule.LAST, search.noise_m)
    crops = schedule.hand_crops(placed, search.scan)
    others = schedule.without_hands(placed, search.scan)
    known = [*priors.terms(), *search.extra]
    terms = schedule.body_terms(priors.surface, search.scan, stage, known, crops, others)
    energy = Energy(priors.surface, terms)
    together = (1.0, HAND_TOGETHER) if others is not None else HAND_TOGETHER
    earlier = Earlier(priors.surface.shape, schedule.shape_basis(priors))
    return covariance(energy, energy.at(placed.x), basis=schedule.basis_of(priors, stage),
                      together=together, earlier=earlier)  # fmt: skip


def _freed(search: BodySearch, chosen: BodyCandidate) -> Array:
    """Return the mesh (V, 3) of the coupled stage."""
    began = time.process_time()
    free = couple(search.surface, search.scan, chosen.placed.x, (), settings=BODY_COUPLING).vertices
    search.seconds["coupled"] = time.process_time() - began
    return free


def _refused(priors: BodyPriors, problem: Finding, dropped: int) -> Fit:
    """Return a fail without a fit: the mean body in an A-pose at the origin."""
    report = {"verdict": "fail", "reason": problem.reason, "message": problem.message,
              "points_dropped": dropped}  # fmt: skip
    placed = priors.surface.at(priors.start)
    return as_fit(placed, Judgement("fail", problem.reason), report)


def as_fit(placed: BodyPlaced, judgement: Judgement, report: dict[str, Any],
           sd_m: Array | None = None) -> Fit:  # fmt: skip
    """Return a placed body as a result."""
    surface = placed.surface
    shape, pose, translation = surface.unpack(placed.x)
    return Fit(
        shape=shape, pose=pose, translation=translation, hand=None,
        vertices=placed.vertices.copy(), joints=placed.joints.copy(),
        verdict=judgement.verdict, reason=judgement.text, report=report, model=surface.model,
        expression=placed.x[surface.expression].copy() if surface.model.n_expression else None,
        vertex_sd_m=np.zeros(0) if sd_m is None else sd_m,
    )  # fmt: skip


def _advice(chosen: BodyCandidate, scan: Scan) -> str | None:
    """Return what a user can do about a fail."""
    s, judgement = chosen.statistics, chosen.judgement
    if judgement.verdict != "fail":
        return None
    size = np.ptp(np.quantile(scan.points, [0.01, 0.99], axis=0), axis=0)
    pose = "bodies stand upright, y up, in something like an A-pose"
    if size.argmax() != 1:
        pose += f", this scan is longest along {'xyz'[int(size.argmax())]}: turn it"
    explained, far = f"{100 * s.explained:.0f} %", f"{100 * s.far:.0f} %"
    return {
        "background": f"{far} of the points are farther than 50 mm from the body that was found; "
        f"cut it out ({pose})",
        "cold_start_failed": f"only {explained} of the points are explained; {pose}, or give a "
        "start",
        "part_missed": "the rest of the body is explained; see the parts in the report",
        "noise_above_spec": f"points scatter by {1e3 * s.noise_m:.1f} mm about the body",
        "shape_limit": "a shape coefficient is beyond 4 standard deviations",
    }.get(judgement.reason)


def _result(
    search: BodySearch, chosen: BodyCandidate, kind: str, dropped: int, cpu_s: float
) -> Fit:
    judgement, model = chosen.judgement, search.surface.model
    report = {
        "verdict": judgement.verdict,
        "reason": judgement.text,
        "hand": None,
        "model": model.name,
        "model_digest": model.digest,
        "preset": "body",
        "start": kind,
        "points": len(search.scan.points),
        "points_dropped": dropped,
        "stages": search.stages,
        "largest_beta": float(np.abs(chosen.placed.x[search.surface.shape]).max(initial=0.0)),
        "statistics": chosen.statistics.to_json(),
        "cpu_s": {"total": cpu_s, **search.seconds},
    }
    if (message := _advice(chosen, search.scan)) is not None:
        report["message"] = message
    return as_fit(chosen.placed, judgement, report, chosen.statistics.sd_m)
