"""The fully resolved description of one sample: a row of the plan."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from synthgen.scene import Scene, from_json, to_json


@dataclass(frozen=True)
class RenderSettings:
    """What the renderer needs beyond the scene.

    ``quality`` is ``plain`` or ``full``; ``denoise`` ``oidn`` or ``none``; ``diffusion`` spreads
    light under the skin.
    """

    quality: str
    spp: int
    max_depth: int
    seed: int
    denoise: str = "none"
    diffusion: bool = False


@dataclass(frozen=True)
class SampleSpec:
    """Everything that makes one sample; a pure function of (config, seed, index, attempt).

    Attributes
    ----------
    index : int
        Position in the corpus.
    attempt : int
        0 in the plan; higher where a sample was rejected after rendering and redrawn.
    scene : Scene
    render : RenderSettings
    factors : dict
        Sampled factors by name (numbers and words), for tables and histograms.
    """

    index: int
    attempt: int
    scene: Scene
    render: RenderSettings
    factors: dict[str, float | int | str]

    def to_json(self) -> dict[str, Any]:
        """Return the spec as nested dicts and lists of JSON types."""
        return {
            "index": self.index,
            "attempt": self.attempt,
            "scene": to_json(self.scene),
            "render": asdict(self.render),
            "factors": dict(self.factors),
        }

    @staticmethod
    def from_json(row: dict[str, Any]) -> SampleSpec:
        """Rebuild the spec that :meth:`to_json` wrote; equal to the original."""
        return SampleSpec(
            index=row["index"],
            attempt=row["attempt"],
            scene=from_json(row["scene"]),
            render=RenderSettings(**row["render"]),
            factors=row["factors"],
        )
