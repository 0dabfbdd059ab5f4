"""Fitting a hand or body model to a scan: the public entry."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from synthgen.errors import ModelError, ShapeError
from synthgen.models import BodyModel, ManoModel, mirror_model, mirror_pose
from synthgen.registration.body_fit import (
    body_surface,
    checked_keypoints,
    checked_pose,
    fit_body,
    start_vector,
)
from synthgen.registration.coarse_model import Starts, coarse_model_of
from synthgen.registration.coupled import couple
from synthgen.registration.far import near_the_origin
from synthgen.registration.fitted import Fit, Side
from synthgen.registration.initialiser import Initialiser, initialiser_of
from synthgen.registration.inspection import Finding, inspect
from synthgen.registration.limit_term import LimitPrior
from synthgen.registration.prior import learned_prior
from synthgen.registration.scan import FARTHEST_M, Scan, checked_points, scan_of
from synthgen.registration.schedule import pca_basis, pca_origin, preset_named
from synthgen.registration.search import Candidate, Search, Settings
from synthgen.registration.search_report import report_of
from synthgen.registration.starts import around, learned_starts, table_starts
from synthgen.registration.surface import surface_of
from synthgen.registration.terms import GaussianPrior, KeypointTerm, Term
from synthgen.registration.verdict import Judgement, explains_more
from synthgen.sampling.limits import limits_of

Array = NDArray[np.float64]
Start = str | tuple[Any, ...]
TURNS = 4
# A given start that explains this much is finished as it is. The coarse stage, which has few
# components and prefers hands that show all their skin, would leave it where a view shows little.
GOOD_START = 0.97
# A failed fit that explains this much has the right basin: the table has nothing to add.
RIGHT_BASIN = 0.97
_FLIP = np.array([-1.0, 1.0, 1.0])
# What bodies take of the options that only hands have.
_OFF = {"hand": (None, "auto"), "preset": ("fast",), "components": (None,), "curved": (0.0,)}


@near_the_origin
def fit(
    points: Any,
    normals: Any,
    model: BodyModel,
    start: Start = "cold",
    hand: str | None = None,
    *,
    preset: str = "fast",
    coupled: bool = False,
    viewpoints: Any = None,
    components: int | None = None,
    keypoints: tuple[Any, Any] | None = None,
    pose_prior: tuple[Any, float] | None = None,
    curved: float = 0.0,
    seed: int = 0,
) -> Fit:
    """Fit a hand or body model to points; a scan that cannot be fitted is a fail with its reason.

    Parameters
    ----------
    points, normals : (N, 3) float
        Metres; outward, or None: estimated.
    model : BodyModel
        A hand in MANO form, of either side, or a body in SMPL+H or SUPR form.
    start : "cold" or (shape, pose, translation)
        Given: the rotation is trusted to about 20 degrees, pose and shape are one hypothesis (a
        SUPR body's may end with its expression). Cold bodies stand upright (y up) in something
        like an A-pose, turned any way about the vertical; cold hands may have any rotation.
    hand : "left", "right", "auto" or None
        None is auto: by fitting the scan and its mirror image. A wrong side is ``other_hand``.
    preset : "fast", "accurate" or "paper"
    coupled : bool
        Also free the mesh from the model (``free_vertices``), for detail that the model lacks.
    viewpoints : (C, 3) float or None
        Where the sensors stood: what they could not see is not missed; orients estimated normals.
    components : int or None
        Keep the fingers within that many principal components (6-45); hand models only.
    keypoints : ((m,) joint numbers, (m, 3) metres) or None
        Known joints.
    pose_prior : ((K, 3) axis-angle of the fitted side, sd_rad) or None
        A protocol's known pose.
    curved : float
        0: the scanned surface is the model's flat triangles; 0.5: smooth, as renderers draw it.
    seed : int
        Of the order of points.

    Raises
    ------
    ShapeError, ModelError
        If arguments do not belong together (not for bad scans).
    """
    if isinstance(model, BodyModel) and model.hand is None:
        _only_hands(hand=hand, preset=preset, components=components, curved=curved)
        known = {"keypoints": keypoints, "pose_prior": pose_prior, "viewpoints": viewpoints}
        with threadpool_limits(limits=1, user_api="blas"):
            return fit_body(points, normals, model, start, coupled=coupled, seed=seed, **known)
    request = _Request(_right(model), preset, coupled, components, keypoints, pose_prior, curved)
    sides, begin = _sides(hand), _start(request, start)
    with threadpool_limits(limits=1, user_api="blas"):
        return _checked(request, points, normals, begin, sides, viewpoints, seed)


def check_options(
    model: BodyModel, start: Start, hand: str | None, preset: str, curved: float
) -> None:
    """Refuse, as :func:`fit` does, what no scan can be fitted with."""
    if isinstance(model, BodyModel) and model.hand is None:
        _only_hands(hand=hand, preset=preset, curved=curved)
        start_vector(body_surface(model), start)
        return
    _sides(hand)
    preset_named(preset)
    _start(_Request(_right(model), preset, False, None, None, None, 0.0), start)


def _only_hands(**given: Any) -> None:
    for name, value in given.items():
        if value not in _OFF[name]:
            raise ShapeError(f"{name}={value!r} is for hand models; leave it out for a body")


def _checked(
    request: _Request,
    points: Any,
    normals: Any,
    start: Array | None,
    sides: tuple[Side, ...],
    viewpoints: Any,
    seed: int,
) -> Fit:
    """Look at the scan first, then fit it."""
    own, given, dropped = checked_points(points, normals)
    if len(own) < 20:
        finding = Finding("no_points", f"{len(own)} finite points; a scan has thousands")
        return _refused(request, finding, sides[0], dropped)
    scan = scan_of(own, given, viewpoints, seed=seed)
    problem = inspect(scan, check_normals=given is not None)
    if problem is not None:
        return _refused(request, problem, sides[0], dropped)
    return _fit(request, scan, start, sides, dropped)


@dataclass(frozen=True, eq=False)
class _Request:
    """Arguments of a fit; the model is a right hand."""

    model: ManoModel
    preset: str
    coupled: bool
    components: int | None
    keypoints: tuple[Any, Any] | None
    pose_prior: tuple[Any, float] | None
    curved: float

    def settings(self, side: Side) -> Settings:
        """Return what one side's search works with; side "left" sees the mirrored scan."""
        surface = surface_of(self.model)
        net = initialiser_of(self.model)
        prior = learned_prior(self.model) if net is None else net.prior
        extra: list[Term] = [LimitPrior(surface.pose, limits_of(self.model))]
        flip = _FLIP if side == "left" else np.ones(3)
        if self.keypoints is not None:
            ids, positions = checked_keypoints(self.keypoints, surface.n_joints)
            extra.append(KeypointTerm(ids, positions * flip, 0.003))
        if self.pose_prior is not None:
            pose = checked_pose(self.pose_prior, surface.n_joints)
            pose = mirror_pose(pose) if side == "left" else pose
            fingers = pose[-15:].ravel()
            spread = np.full(45, float(self.pose_prior[1]))
            extra.append(GaussianPrior(surface.fingers, fingers, spread))
        basis = None if self.components is None else pca_basis(surface, self.components)
        return Settings(self.model, surface, prior, coarse_model_of(self.model, prior),
                        preset_named(self.preset), extra, basis, pca_origin(surface),
                        curved=self.curved)  # fmt: skip


def _right(model: BodyModel) -> ManoModel:
    if not isinstance(model, ManoModel):
        name = getattr(model, "name", model)
        raise ModelError(f"model {name!r} is no hand in MANO form and no body; fit takes these")
    return mirror_model(model) if model.hand == "left" else model


def _sides(hand: str | None) -> tuple[Side, ...]:
    if hand in (None, "auto"):
        return ("right", "left")
    if hand == "right":
        return ("right",)
    if hand == "left":
        return ("left",)
    raise ShapeError(f"hand={hand!r}; expected 'left', 'right', 'auto' or None")


def _start(request: _Request, start: Start) -> Array | None:
    """Return the start as a vector of the fitted side, or None when cold."""
    if isinstance(start, str):
        if start != "cold":
            raise ShapeError(f"start={start!r}; expected 'cold' or (shape, pose, translation)")
        return None
    parts = [np.asarray(part, dtype=np.float64) for part in start]
    n, nb = len(request.model.parents), request.model.n_shape
    good = len(parts) == 3 and parts[0].ndim == 1 and len(parts[0]) <= nb
    if not good or parts[1].size != 3 * n or parts[2].size != 3:
        raise ShapeError(
            f"start has shapes {[part.shape for part in parts]}; expected (up to {nb},), "
            f"({n}, 3), (3,)"
        )
    shape, pose, translation = parts
    x = surface_of(request.model).pack(shape, pose.reshape(-1, 3), translation.ravel())
    if not (np.abs(x) < FARTHEST_M).all():
        raise ShapeError(f"start holds a number that is not finite, or beyond {FARTHEST_M:g}")
    return x


def _fit(
    request: _Request, scan: Scan, start: Array | None, sides: tuple[Side, ...], dropped: int
) -> Fit:
    began = time.process_time()
    searches = {side: _Run(request, scan, side, start) for side in sides}
    order = sorted(sides, key=lambda side: searches[side].energy)
    best: tuple[Side, Candidate] | None = None
    for side in order:
        found = searches[side].search.run(searches[side].vectors)
        if best is None or found.beats(best[1]):
            best = (side, found)
        if found.settled:
            break
    assert best is not None
    side, chosen = best
    explained = 0.0 if chosen.statistics is None else chosen.statistics.explained
    lost = not chosen.accepted and explained < RIGHT_BASIN
    if lost and not searches[side].escalated:
        chosen = searches[side].escalate()
    judgement = chosen.judgement or Judgement("fail", "cold_start_failed")
    if judgement.verdict == "fail" and len(sides) == 1:
        judgement = _other_side(request, scan, side, judgement, chosen)
    return _result(request, searches[side], judgement, chosen, dropped, began)


class _Run:
    """One side's hypotheses after the coarse stage."""

    def __init__(self, request: _Request, scan: Scan, side: Side, start: Array | None) -> None:
        self.side, self.scan = side, scan if side == "right" else scan.mirrored()
        self.settings = request.settings(side)
        self.search = Search(self.settings, self.scan)
        self.net = initialiser_of(request.model)
        self.escalated = self.net is None and start is None
        self.start = start
        if start is not None:
            self.kind = "given"
            own = start if side == "right" else _mirrored(self.settings, start)
            hypotheses = around(self.settings.coarse, own, self.scan.centre)
        else:
            self.kind = "cold, table" if self.net is None else "cold, learned"
            hypotheses = self._table() if self.net is None else self._learned(self.net)
        self.vectors, energies = self.search.coarse(hypotheses)
        if start is not None and self.search.explained(own) >= GOOD_START:
            self.vectors = np.concatenate([own[None], self.vectors])
        self.energy = float(energies[0])

    def _table(self) -> Starts:
        s = self.search
        return table_starts(self.settings.coarse, s.points, s.normals, self.scan.centre)

    def _learned(self, net: Initialiser) -> Starts:
        s = self.search
        return learned_starts(net, self.settings.coarse, s.points, s.normals, TURNS)

    def escalate(self) -> Candidate:
        """Nothing was accepted: try the table too, or, from a given start, a cold one."""
        self.escalated = True
        if self.start is not None and self.net is not None:
            self.kind += " + learned"
            vectors, _ = self.search.coarse(self._learned(self.net))
        else:
            self.kind += " + table"
            vectors, _ = self.search.coarse(self._table())
        for k, x in enumerate(vectors[:2]):
            if self.search.finish(x, f"t{k}").accepted:
                break
        return self.search.best


def _mirrored(settings: Settings, x: Array) -> Array:
    shape, pose, translation = settings.surface.unpack(x)
    return settings.surface.pack(shape, mirror_pose(pose), translation * _FLIP)


def _other_side(
    request: _Request, scan: Scan, side: Side, failed: Judgement, own: Candidate
) -> Judgement:
    """See whether the other side fits, after the given one failed, and fits better."""
    other: Side = "left" if side == "right" else "right"
    run = _Run(request, scan, other, None)
    found = run.search.run(run.vectors[:1])
    if found.accepted and explains_more(found.statistics, own.statistics):
        return Judgement("fail", "other_hand")
    return failed


def _refused(request: _Request, problem: Finding, side: Side, dropped: int) -> Fit:
    """Return a fail without a fit: the mean hand at the origin."""
    surface = surface_of(request.model)
    placed = surface.at(np.zeros(surface.n))
    report = {"verdict": "fail", "reason": problem.reason, "message": problem.message,
              "points_dropped": dropped}  # fmt: skip
    shape, pose, translation = surface.unpack(placed.x)
    model = request.model if side == "right" else mirror_model(request.model)
    flip = np.ones(3) if side == "right" else _FLIP
    return Fit(shape, pose, translation, side, placed.vertices * flip, placed.joints * flip,
               "fail", problem.reason, report, model)  # fmt: skip


def _result(
    request: _Request,
    run: _Run,
    judgement: Judgement,
    chosen: Candidate,
    dropped: int,
    began: float,
) -> Fit:
    surface, side = run.settings.surface, run.side
    placed = surface.at(chosen.x)
    shape, pose, translation = surface.unpack(chosen.x)
    flip = np.ones(3)
    model: BodyModel = request.model
    free = _freed(request, run, chosen) if judgement.verdict != "fail" else None
    if side == "left":
        model, pose, flip = mirror_model(request.model), mirror_pose(pose), _FLIP
    return Fit(
        shape=shape,
        pose=pose,
        translation=translation * flip,
        hand=side,
        vertices=placed.vertices * flip,
        joints=placed.joints * flip,
        verdict=judgement.verdict,
        reason=judgement.text,
        report=report_of(
            run.search,
            judgement,
            chosen,
            hand=side,
            start=run.kind,
            dropped=dropped,
            cpu_s=time.process_time() - began,
        ),
        model=model,
        vertex_sd_m=np.zeros(0) if chosen.statistics is None else chosen.statistics.sd_m,
        free_vertices=None if free is None else free * flip,
    )


def _freed(request: _Request, run: _Run, chosen: Candidate) -> Array | None:
    if not request.coupled or chosen.statistics is None:
        return None
    began = time.process_time()
    settings = run.settings
    free = couple(settings.surface, run.scan, chosen.x, settings.priors(1.0)).vertices
    run.search.seconds["coupled"] = time.process_time() - began
    return free


def fit_many(scans: Sequence[tuple[Any, Any]], model: BodyModel, **settings: Any) -> list[Fit]:
    """Fit several scans one after the other; arguments as :func:`fit`."""
    return [fit(points, normals, model, **settings) for points, normals in scans]
