"""Settings of the skin: tones, and a switch for every ingredient of its look."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from synthgen.config.sections import Section, Share, UnitRange

Gain = Annotated[float, Field(ge=0.0, le=3.0)]


class SkinSettings(Section):
    """Look of the skin."""

    tones: UnitRange = (0.0, 1.0)
    """Range of skin tones, 0 the lightest to 1 the darkest; uniform in it, [lowest, highest]."""

    detail: bool = False
    """Baked maps of creases, nails, veins and gloss under a bump map, instead of smooth skin of
    three colours. In full true."""

    relief_m: float = Field(default=0.0, ge=0.0, le=0.004)
    """Largest height of tendons, knuckles, wrist bones and veins over the model's surface, metres;
    recorded with every sample, labels follow it; 0 draws the model's surface. In full 0.002."""

    creases: Gain = 1.0
    """Gain of wrinkles, folds and palm lines; 0 leaves them away."""

    veins: Gain = 1.0
    """Gain of the veins' colour and relief."""

    mottle: Gain = 1.0
    """Gain of the unevenness of blood and pigment."""

    freckles: Gain = 1.0
    """Gain of the share of freckles; 0 leaves moles away too."""

    sweat: Gain = 1.0
    """Gain of the gloss of moist skin."""

    varnish: Share = 0.0
    """Share of people with painted nails. In full 0.06."""
