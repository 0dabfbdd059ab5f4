"""Keyed random streams and samplers of shape, pose, placement and appearance."""

from synthgen.sampling.spec import RenderSettings, SampleSpec
from synthgen.sampling.streams import stream

__all__ = ["RenderSettings", "SampleSpec", "stream"]
