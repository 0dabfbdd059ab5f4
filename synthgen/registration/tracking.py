"""Tracking a subject through a sequence of scans (Eq. 20-23).

The subject's shape is estimated over the first frames, then frozen: a subject-specific template.
Every frame starts from the one before. A frame that cannot be fitted is held, not the end.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from synthgen.errors import ShapeError
from synthgen.models import BodyModel
from synthgen.registration.fitted import Fit
from synthgen.registration.inspection import Finding
from synthgen.registration.scan import Scan
from synthgen.registration.template import subject_offset
from synthgen.registration.tracked import Follower, Frame, Place, is_lost
from synthgen.registration.tracking_body import BodyFollower
from synthgen.registration.tracking_hand import HandFollower
from synthgen.registration.verdict import Judgement

Array = NDArray[np.float64]
FIRST = 4
# Faster changes are jumps of the parametrisation, not motion to go on with.
FASTEST = 0.35
# First frames that lie off the model by so many times their own scatter are not the model's shape.
MISFIT, LEAST_NOISE_M = 1.1, 1e-4


@dataclass(frozen=True, eq=False)
class Track:
    """A tracked sequence.

    Attributes
    ----------
    fits : tuple of Fit
        One a frame. Verdict "unobserved" names hands that are held; a failed frame repeats the
        last good one.
    shape : (nb,)
        The subject's, in all frames.
    model : BodyModel
        Whose parameters they are; with the subject's template, if that was tracked.
    report : dict
        JSON types.
    offset : (V, 3) or None
        Of the subject's template from the model's, metres; of a right hand.
    """

    fits: tuple[Fit, ...]
    shape: Array
    model: BodyModel
    report: dict[str, Any]
    offset: Array | None = None


def track(
    frames: Iterable[tuple[Any, Any]],
    model: BodyModel,
    start: Any = "cold",
    hand: str | None = None,
    *,
    shape: Any = None,
    first: int = FIRST,
    template: bool | None = None,
    coupled: bool = False,
    seed: int = 0,
    done: Callable[[int, Fit], None] | None = None,
    paused: Callable[[Place], None] | None = None,
    resume: Place | None = None,
) -> Track:
    """Fit a model to the scans of a moving subject.

    Parameters
    ----------
    frames : iterable of (points (N, 3), normals (N, 3) or None)
        Metres, in order; read one at a time after the first few.
    model : BodyModel
        SMPL+H or SUPR form, or a hand in MANO form.
    start : "cold" or (shape, pose, translation)
        Of the first frame; see :func:`synthgen.registration.fit`.
    hand : "left", "right", "auto" or None
        Side of a hand model.
    shape : (nb,) or None
        The subject's betas; None: estimated over the ``first`` frames.
    template : bool or None
        Track the subject's own template, of the same frames (Eq. 20): the model's with an offset;
        fits' ``model`` has it. None: where they lie off the model by more than their noise. Not
        with a given ``shape``.
    coupled : bool
        Also free the mesh of every frame that is followed from the model (``free_vertices``).
    seed : int
        Of the order of points.
    done, paused : function of (int, Fit), and of Place
        Called after every frame; a place is all that the next frame needs to know.
    resume : Place or None
        Go on from there; ``frames`` are those that are left.

    Raises
    ------
    ShapeError, ModelError
        If arguments do not belong together, or there are no frames (not for bad scans).
    """
    if first < 1:
        raise ShapeError(f"first={first}: the shape is estimated over at least one frame")
    _check_side(model, hand)
    upcoming = iter(frames)
    early = list(islice(upcoming, first))
    if not early:
        raise ShapeError("there are no frames; pass (points, normals) of at least one")
    follower = BodyFollower(model, seed) if model.hand is None else HandFollower(model, hand, seed)
    with threadpool_limits(limits=1, user_api="blas"):
        walk = _begun(follower, early, start, shape, template, resume)
        walk.coupled = coupled
        return _walked(walk, _followed(walk, chain(early, upcoming), done, paused))


def _begun(
    follower: Follower, early: list[tuple[Any, Any]], start: Any, shape: Any,
    template: bool | None, resume: Place | None,
) -> _Walk:  # fmt: skip
    """Return the sequence before its first frame, or where it stopped."""
    if resume is not None:
        return _Walk.at(follower, start, resume)
    if shape is not None:
        return _Walk(follower, start, _given(shape, follower.surface.model))
    began = time.process_time()
    walk = _acquainted(follower, early, start, template)
    walk.shape_s = time.process_time() - began
    return walk


def _walked(walk: _Walk, steps: Iterator[Fit]) -> Track:
    began = time.process_time()
    fits = list(steps)
    betas = fits[-1].shape if walk.betas is None else walk.betas
    report = _report(fits, walk.shape_s, walk.shape_s + time.process_time() - began)
    return Track(tuple(fits), betas, fits[-1].model, report, walk.offset)


def _check_side(model: BodyModel, hand: str | None) -> None:
    if model.hand is None and hand not in (None, "auto"):
        raise ShapeError(f"hand={hand!r} is for hand models; leave it out for a body")
    if hand not in (None, "auto", "left", "right"):
        raise ShapeError(f"hand={hand!r}; expected 'left', 'right', 'auto' or None")


def _followed(
    walk: _Walk,
    frames: Iterable[tuple[Any, Any]],
    done: Callable[[int, Fit], None] | None,
    paused: Callable[[Place], None] | None,
) -> Iterator[Fit]:
    for k, (points, normals) in enumerate(frames):
        fit = walk.step(points, normals)
        if k == 0 and walk.shape_s:  # what the first frames told was for all
            fit.report["cpu_s"]["shape"] = walk.shape_s
        if done is not None:
            done(k, fit)
        if paused is not None:
            paused(walk.place)
        yield fit


def _given(shape: Any, model: BodyModel) -> Array:
    betas = np.zeros(model.n_shape)
    values = np.asarray(shape, dtype=np.float64)
    if values.ndim != 1 or len(values) > len(betas) or not np.isfinite(values).all():
        raise ShapeError(
            f"shape is {values.shape}; expected up to ({model.n_shape},) finite coefficients"
        )
    betas[: len(values)] = values
    return betas


def _acquainted(
    follower: Follower, frames: list[tuple[Any, Any]], start: Any, template: bool | None
) -> _Walk:
    """Average the betas of the first frames (Eq. 20) and begin at the first that can be fitted."""
    free = _Walk(follower, start, None)
    fits = [free.step(points, normals) for points, normals in frames]
    good = [k for k, fit in enumerate(fits) if fit.report["followed"]]
    if not good:
        return _Walk(follower, "cold", None, freeze=True)
    betas, offset = np.mean([fits[k].shape for k in good], axis=0), None
    if template is not False:
        pairs = [(fits[k], follower.scan(*frames[k])) for k in good]
        offset = _offset(follower, pairs, betas, template)
        follower.recall(None, offset)
    walk = _Walk(follower, "cold", betas)
    walk.offset = offset
    walk.begin(fits[good[0]])
    return walk


def _offset(
    follower: Follower, pairs: list[tuple[Fit, Any]], betas: Array, template: bool | None
) -> Array | None:
    """Return what the subject's template adds (V, 3); None where the model's own explains it."""
    off = [
        1e-3 * fit.report["statistics"]["noise_mm"] / max(scan.local_noise_m, LEAST_NOISE_M)
        for fit, scan in pairs
    ]
    if template is None and float(np.median(off)) < MISFIT:
        return None
    frames = [follower.aligned(fit, scan) for fit, scan in pairs]
    return subject_offset(follower.surface.model, frames, betas, follower.share)


class _Walk:
    """A sequence in progress.

    betas None: they are fitted in every frame, or with ``freeze`` in the first that can be fitted.
    """

    def __init__(
        self, follower: Follower, start: Any, betas: Array | None, *, freeze: bool = False
    ) -> None:
        self.follower, self.start, self.betas, self.freeze = follower, start, betas, freeze
        self.unseen = dict.fromkeys(follower.sides, 0)
        self.x: Array | None = None
        self.motion: Array = np.zeros(0)
        self.coupled = False
        self.offset: Array | None = None
        self.shape_s = 0.0

    @classmethod
    def at(cls, follower: Follower, start: Any, place: Place) -> _Walk:
        """Return a sequence that stands at a place."""
        follower.recall(place.hand, place.offset)
        walk = cls(follower, "cold" if place.cold else start, place.betas, freeze=place.freeze)
        walk.x, walk.motion, walk.unseen = place.x, place.motion, dict(place.unseen)
        walk.offset = place.offset
        return walk

    @property
    def place(self) -> Place:
        """Where the sequence stands."""
        cold = isinstance(self.start, str)
        return Place(self.x, self.motion, dict(self.unseen), self.betas, self.freeze, cold,
                     self.follower.found, self.offset)  # fmt: skip

    def step(self, points: Any, normals: Any) -> Fit:
        """Fit the next frame, or hold the last one."""
        began = time.process_time()
        scan = self.follower.scan(points, normals)
        if isinstance(scan, Finding):
            return self._held(scan, began)
        if self.x is None:
            found = self.follower.begin(points, normals, self.start)
            self.start = "cold"
            if is_lost(found.verdict, found.reason):
                return replace(found, report={**found.report, "followed": False})
            self.begin(found)
        frame, kind = self._follow(scan), "frame before"
        if frame.lost:
            problem = self.follower.inspect(scan)
            if problem is not None:
                return self._held(problem, began)
            frame, kind = self._afresh(points, normals, scan) or frame, "afresh"
        return self._kept(frame, kind, scan, began)

    def begin(self, found: Fit) -> None:
        """Go on from a fit that knew nothing of the frames before."""
        self.x = self.follower.vector(found)
        if self.betas is not None:
            self.x[self.follower.surface.shape] = self.betas
        self.motion = np.zeros(len(self.x))
        self.unseen = dict.fromkeys(self.follower.sides, 0)

    def _follow(self, scan: Scan) -> Frame:
        assert self.x is not None
        return self.follower.follow(
            scan, self.x, self.x + self.motion, self.unseen, shape_free=self.betas is None
        )

    def _afresh(self, points: Any, normals: Any, scan: Scan) -> Frame | None:
        """Fit a frame that could not be followed as a single scan; None: that fails too."""
        assert self.x is not None
        kept = self.x, self.motion, self.unseen
        last = self.follower.fitted(self.x, Judgement("pass"), {})
        found = self.follower.begin(points, normals, (last.shape, last.pose, last.translation))
        if not is_lost(found.verdict, found.reason):
            self.begin(found)
            frame = self._follow(scan)
            if not frame.lost:
                return frame
        self.x, self.motion, self.unseen = kept
        return None

    def _kept(self, frame: Frame, kind: str, scan: Scan, began: float) -> Fit:
        judgement = frame.judgement
        if frame.lost:
            self._stay()
        else:
            self._move(frame)
        assert self.x is not None
        free = self.follower.freed(self.x, scan) if self.coupled and not frame.lost else None
        report = {
            "verdict": judgement.verdict, "reason": judgement.text, "start": kind,
            "followed": not frame.lost, "points": len(scan.points),
            "unseen_frames": dict(self.unseen), "statistics": frame.report,
            "cpu_s": {"total": time.process_time() - began},
        }  # fmt: skip
        return replace(self.follower.fitted(self.x, judgement, report), free_vertices=free)

    def _move(self, frame: Frame) -> None:
        assert self.x is not None
        moved = frame.x - self.x
        moved[self.follower.surface.shape] = 0
        for side, count in self.unseen.items():
            moved[self.follower.hand(side)] /= 1 + count
        self.motion = np.where(np.abs(moved) < FASTEST, moved, 0.0)
        self.x, self.unseen = frame.x, dict(frame.unseen)
        if self.freeze and self.betas is None:
            self.betas = self.x[self.follower.surface.shape].copy()

    def _stay(self) -> None:
        self.motion = np.zeros_like(self.motion)
        self.unseen = {side: count + 1 for side, count in self.unseen.items()}

    def _held(self, problem: Finding, began: float) -> Fit:
        """Repeat the last frame where a scan shows nothing; before any, return the model's mean."""
        self._stay()
        surface = self.follower.surface
        x = np.zeros(surface.n) if self.x is None else self.x
        if self.x is None and self.betas is not None:
            x[surface.shape] = self.betas
        judgement = Judgement("fail", problem.reason)
        alone = len(self.follower.sides) == 1 and self.x is not None
        if alone and problem.reason == "no_points":  # a hand that is not there
            judgement = Judgement("unobserved", "hole", self.follower.sides)
        report = {
            "verdict": judgement.verdict, "reason": judgement.text, "message": problem.message,
            "followed": False, "points": 0, "unseen_frames": dict(self.unseen),
            "statistics": None, "cpu_s": {"total": time.process_time() - began},
        }  # fmt: skip
        return self.follower.fitted(x, judgement, report)


def _report(fits: list[Fit], first_s: float, total_s: float) -> dict[str, Any]:
    verdicts = [fit.verdict for fit in fits]
    return {
        "frames": len(fits),
        "verdicts": {v: verdicts.count(v) for v in ("pass", "unobserved", "fail")},
        "reasons": [fit.reason for fit in fits],
        "followed": [bool(fit.report["followed"]) for fit in fits],
        "unseen_frames": [fit.report.get("unseen_frames") for fit in fits],
        "cpu_s": {"shape": first_s, "total": total_s},
    }
