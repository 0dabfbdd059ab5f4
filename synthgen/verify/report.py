"""What a verification found."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Failure:
    """One check that one sample fails: the value found and the limit it broke."""

    sample: int
    view: int
    check: str
    value: float
    limit: float
    message: str


@dataclass
class VerifyReport:
    """Failures, and per check the worst value seen beside its limit.

    ``lacking`` counts views by the column that they lack: ``depth`` where a corpus stores none.
    """

    samples: int = 0
    views: int = 0
    failures: list[Failure] = field(default_factory=list)
    worst: dict[str, tuple[float, float]] = field(default_factory=dict)
    lacking: dict[str, int] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.failures

    def measure(
        self, sample: int, view: int, check: str, value: float, limit: float, message: str
    ) -> None:
        """Record a measurement that must not exceed its limit (NaN fails)."""
        seen = self.worst.get(check, (-1.0, limit))[0]
        self.worst[check] = (max(seen, value) if value == value else value, limit)
        if not value <= limit:
            self.failures.append(Failure(sample, view, check, value, limit, message))

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON types."""
        return {
            "ok": self.ok,
            "samples": self.samples,
            "views": self.views,
            "lacking": self.lacking,
            "worst": {k: {"value": v, "limit": m} for k, (v, m) in sorted(self.worst.items())},
            "failures": [asdict(failure) for failure in self.failures],
        }
