"""From statistics to a verdict: pass, unobserved, or fail with a reason from a fixed list."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from synthgen.registration.statistics import DOUBT, PARTS, Statistics

Verdict = Literal["pass", "unobserved", "fail"]
REASONS = (
    "no_points",  # empty scan, or too few finite points
    "scale",  # extent does not fit a hand or body: wrong unit
    "background",  # much of the scan is no hand or body
    "two_hands",  # two hand-sized pieces
    "two_bodies",  # two body-sized pieces
    "flipped_normals",  # normals point into the skin
    "other_hand",  # fits as the other side
    "cold_start_failed",  # no start led to a fit that explains the scan
    "finger_swap",  # (part) two parts are badly explained
    "finger_missed",  # (part) one part is badly explained
    "part_missed",  # (parts) parts of a body are badly explained
    "hole",  # (parts) the scan does not determine them: verdict unobserved
    "shape_limit",  # a shape coefficient beyond 4 standard deviations
    "not_converged",  # the solver was stopped on its way
    "noise_above_spec",  # points scatter by more than 2 mm, a body's by more than 4
    "truth_mismatch",  # round trip only: the fit is good and the truth is far
    "false_pass",  # round trip only: the same, but the truth explains the points as well
)
UNEXPLAINED, RATIO, EXPLAINED = 0.035, 1.17, 0.95
# Where the model misfits (detail it cannot express), residuals are no longer like noise.
MISFIT, MISFIT_RATIO, MISFIT_UNEXPLAINED = 1.15, 2.5, 0.10
# Biased patches of a part that is right are chance (6e-5) and the fit's own small errors; where the
# whole hand is biased, the model misfits everywhere and no part stands out.
BIASED, BIASED_RATIO = 0.05, 5.0
# Of a pass, at a noise of up to the second; beyond it a limit grows as the noise does.
SD95_M, USUAL_NOISE_M = 6e-4, 2e-4
# A finger that is not there is known to 9-50 mm by what its neighbours and the prior say; whole
# hands with 0.6 mm of unmodelled detail to 9 mm at worst, but for fingers hidden in a fist.
HIDDEN_SD95_M = 9e-3
# That holds of a finger whose last phalanx shows by this share at least; what shows less must be
# known better, in proportion, down to the second. Of 105 cut fingers of hands with 0.3-1 mm of
# detail, up to 0.13 of the phalanx shows, where the rest's points lie, and the finger is known to
# 2.6-13 mm; whole thumbs that are missing are fitted beside other fingers' points, 9-20 mm off.
# Of 71 whole hands less than this shows of tips hidden in fists alone.
TIP_COVERED, UNSHOWN_SD95_M = 0.25, 2.5e-3
FAR, NOISE_M, SHAPE_SD = 0.2, 2e-3, 4.0
PENDING = 0.01  # one more step would lower the energy by a hundredth: the solver was cut short


@dataclass(frozen=True)
class Judgement:
    """A verdict, its reason ("" for pass) and the parts it is about."""

    verdict: Verdict
    reason: str = ""
    parts: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The reason with its parts: ``finger_missed(index)``."""
        return f"{self.reason}({', '.join(self.parts)})" if self.parts else self.reason


def sd_limit_m(noise_m: float, inflation: float = 1.0) -> float:
    """Largest predicted vertex sd (95 %) of a pass.

    It grows with the scan's noise and with a misfit of the model: ``unobserved`` is about what the
    scan shows, not about what the model lacks.
    """
    return float((SD95_M + max(noise_m - USUAL_NOISE_M, 0.0)) * np.sqrt(inflation))


def misfits(s: Statistics) -> bool:
    """Tell whether the model lies off the scan by more than the scan's own scatter."""
    return s.noise_m > MISFIT * s.local_noise_m


def biased_parts(s: Statistics) -> tuple[str, ...]:
    """Parts that lie off the scan by more than noise, while the rest of the hand does not."""
    limit = _biased_limit(s)
    return tuple(p for p, share in zip(PARTS, s.biased, strict=True) if share > limit)


def _biased_limit(s: Statistics) -> float:
    known = s.biased[np.isfinite(s.biased)]
    return max(BIASED, BIASED_RATIO * float(np.median(known))) if len(known) else np.inf


def unexplained_limits(s: Statistics, share: float) -> np.ndarray:
    """Shares (6,) that no right part reaches: more where few points lie near it, by chance."""
    return share + DOUBT * np.sqrt(share * (1 - share) / np.maximum(s.counts, 1))


def worst_part(s: Statistics, ratio: float, unexplained: np.ndarray, misfit: bool) -> str:
    """Part at fault: the one farthest beyond its limits, by whichever statistic tells most.

    A finger bent into its neighbour leaves points that lie nearer to the neighbour, unexplained.
    """
    biased = np.zeros(len(PARTS)) if misfit else s.biased / _biased_limit(s)
    beyond = np.nan_to_num(np.stack([s.ratios / ratio, s.unexplained / unexplained, biased]))
    return PARTS[int(beyond.max(axis=0).argmax())]


def hidden_parts(s: Statistics) -> tuple[str, ...]:
    """Parts that the scan does not determine: beside the rest, or however coarse the rest is."""
    limit = sd_limit_m(s.noise_m, s.inflation)
    limit = min(limit, HIDDEN_SD95_M) if s.sd95_all_m > limit else HIDDEN_SD95_M
    shown = np.minimum(s.tip_coverage / TIP_COVERED, 1.0)
    least = min(sd_limit_m(s.noise_m, s.inflation), UNSHOWN_SD95_M)
    limits = np.maximum(limit * shown, least)
    return tuple(p for p, sd, most in zip(PARTS, s.sd95_m, limits, strict=True) if sd > most)


def explains_more(found: Statistics | None, other: Statistics | None) -> bool:
    """Tell whether a fit explains a scan better than another one does.

    One that was never finished explains nothing. A fit that is accepted need not be better: where
    it misfits it may claim parts that the scan does not show, and shows nothing of what the other
    explains.
    """
    if found is None or other is None:
        return found is not None
    shown = any(part not in hidden_parts(found) for part in PARTS)
    return shown and found.explained > other.explained and found.noise_m < other.noise_m


def judge(s: Statistics, shape: np.ndarray) -> Judgement:
    """Judge one finished fit."""
    misfit = misfits(s)
    ratio, share = (MISFIT_RATIO, MISFIT_UNEXPLAINED) if misfit else (RATIO, UNEXPLAINED)
    unexplained = unexplained_limits(s, share)
    bad = [PARTS[k] for k in np.argsort(-np.nan_to_num(s.unexplained))
           if s.unexplained[k] >= unexplained[k]]  # fmt: skip
    if s.noise_m > NOISE_M:
        return Judgement("fail", "noise_above_spec")
    # One or two bad fingers may be a large share of the points; the palm tells a wrong basin.
    lost = s.explained < EXPLAINED and ("palm" in bad or not bad)
    if lost or len(bad) > 2:
        return Judgement("fail", "cold_start_failed")
    if s.far > FAR:
        return Judgement("fail", "background")
    if len(bad) == 2 and "palm" not in bad:
        return Judgement("fail", "finger_swap", tuple(bad))
    if len(bad) == 2:
        return Judgement("fail", "finger_missed", tuple(bad))
    if bad or s.ratio >= ratio:
        worst = worst_part(s, ratio, unexplained, misfit)
        return Judgement("fail", "finger_missed", (worst,))
    if not misfit and (wrong := biased_parts(s)):
        return Judgement("fail", "finger_missed", wrong)
    if s.pending > PENDING:
        return Judgement("fail", "not_converged")
    if np.abs(shape).max(initial=0.0) > SHAPE_SD:
        return Judgement("fail", "shape_limit")
    hidden = hidden_parts(s)
    return Judgement("unobserved", "hole", hidden) if hidden else Judgement("pass")
