"""What a user can do about a hand's scan that could not be fitted."""

from __future__ import annotations

from synthgen.registration.statistics import Statistics
from synthgen.registration.verdict import NOISE_M, SHAPE_SD, Judgement

# A scatter about planes of few neighbours is up to half of the noise; more is no noise.
FAR_OFF = 3.0


def advice(judgement: Judgement, found: Statistics | None, side: str) -> str | None:
    """Return a sentence for a fail, None for anything else; ``side`` is the one that was fitted."""
    if judgement.verdict != "fail":
        return None
    other = "left" if side == "right" else "right"
    parts = " and ".join(judgement.parts)
    explained = "" if found is None else f"only {100 * found.explained:.0f} % of them are explained"
    off = f"the points at the {parts} do not lie on the model's skin: see the picture of the fit"
    return {
        "other_hand": f"the scan fits as a {other} hand: ask for hand {other} or auto",
        "cold_start_failed": f"no hand was found in the points{explained and ': ' + explained}; "
        "leave only one hand in the scan, or give a start",
        "background": f"{0 if found is None else 100 * found.far:.0f} % of the points are farther "
        "than 10 mm from the hand that was found; cut it out",
        "noise_above_spec": _noise(found),
        "finger_missed": off,
        "finger_swap": f"{off}; give a start if they are each other's",
        "not_converged": "the solver was stopped on its way; give this fit as the start",
        "shape_limit": f"a shape coefficient is beyond {SHAPE_SD:g} standard deviations: check the "
        "scan's unit, or whether it is a hand of this model's kind",
    }.get(judgement.reason)


def _noise(found: Statistics | None) -> str:
    if found is None:
        return ""
    noise, local = 1e3 * found.noise_m, 1e3 * found.local_noise_m
    if noise > FAR_OFF * local:
        return (
            f"the model lies {noise:.1f} mm off the points, which scatter by only {local:.1f} mm: "
            "what was scanned is no hand of this model's kind"
        )
    return f"the points scatter by {noise:.1f} mm; at most {1e3 * NOISE_M:g} mm can be judged"
