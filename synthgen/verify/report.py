"""What a verification found."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

import cv2

from synthgen.errors import SynthgenError

# What reading damaged labels may raise: a finding about that sample, not the end of the others'.
UNREADABLE = (SynthgenError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError,
              StopIteration, cv2.error)  # fmt: skip


@dataclass(frozen=True)
class Failure:
    """One check that one sample fails: the value found and the limit it broke."""

    sample: int
    view: int
    check: str
    value: float
    limit: float
    message: str


@dataclass(frozen=True)
class Unjudged:
    """One check that could not judge something of a sample, and why; it is no pass."""

    sample: int
    view: int
    check: str
    reason: str
    times: int = 1


@dataclass
class VerifyReport:
    """Failures, and per check the worst value seen beside its limit.

    ``planned`` counts the samples of the plan, of which ``there`` are made.
    ``lacking`` counts views by the column that they lack: ``depth`` where a corpus stores none.
    ``unjudged`` is what a check could not judge; ``judged`` counts what each did judge.
    """

    samples: int = 0
    views: int = 0
    planned: int = 0
    there: int = 0
    failures: list[Failure] = field(default_factory=list)
    worst: dict[str, tuple[float, float]] = field(default_factory=dict)
    lacking: dict[str, int] = field(default_factory=dict)
    unjudged: list[Unjudged] = field(default_factory=list)
    judged: Counter[str] = field(default_factory=Counter)

    @property
    def ok(self) -> bool:
        """Whether nothing failed; see :attr:`never_judged` for what nothing is known about."""
        return not self.failures

    @property
    def never_judged(self) -> list[str]:
        """Checks that could judge nothing of what was looked at, sorted."""
        return sorted({row.check for row in self.unjudged} - set(self.judged))

    def measure(
        self,
        sample: int,
        view: int,
        check: str,
        value: float,
        limit: float,
        message: str,
        times: int = 1,
    ) -> None:
        """Record a measurement, of so many things, that must not exceed its limit (NaN fails)."""
        # limits may differ from picture to picture: the worst is what comes nearest to its own
        known, bound = self.worst.get(check, (-float("inf"), limit))
        if known == known and not value - limit <= known - bound:
            self.worst[check] = (value, limit)
        self.judged[check] += times
        if not value <= limit:
            self.failures.append(Failure(sample, view, check, value, limit, message))

    def not_judged(self, sample: int, view: int, check: str, reason: str, times: int = 1) -> None:
        """Record that a check could not judge something, or so many things."""
        self.unjudged.append(Unjudged(sample, view, check, reason, times))

    def reasons(self) -> dict[str, dict[str, int]]:
        """How often each check could not judge, by reason: ``{check: {reason: times}}``."""
        found: dict[str, dict[str, int]] = {}
        for row in sorted(self.unjudged, key=lambda row: (row.check, row.reason)):
            reasons = found.setdefault(row.check, {})
            reasons[row.reason] = reasons.get(row.reason, 0) + row.times
        return found

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON types."""
        return {
            "ok": self.ok,
            "samples": self.samples,
            "views": self.views,
            "planned": self.planned,
            "there": self.there,
            "lacking": self.lacking,
            "not_judged": {
                check: {"judged": self.judged[check], "not_judged": sum(reasons.values()),
                        "reasons": reasons}
                for check, reasons in self.reasons().items()
            },
            "worst": {k: {"value": v, "limit": m} for k, (v, m) in sorted(self.worst.items())},
            "failures": [asdict(failure) for failure in self.failures],
        }  # fmt: skip


@dataclass(frozen=True)
class Record:
    """Where the findings about one view go (-1: the sample's), or about one part of it."""

    report: VerifyReport
    sample: int
    view: int = -1
    about: str = ""

    def measure(self, check: str, value: Any, limit: float, message: str, times: int = 1) -> None:
        """Record a measurement that must not exceed its limit."""
        told = self.about + message
        self.report.measure(self.sample, self.view, check, float(value), limit, told, times)

    def skip(self, check: str, reason: str, times: int = 1) -> None:
        """Record that the check could not judge it."""
        self.report.not_judged(self.sample, self.view, check, reason, times)
