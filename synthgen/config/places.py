"""Sections of the schema for what stands around and on the hand, and for the camera's faults.

"In full" names the value that quality ``full`` takes where a configuration sets none.
"""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from synthgen.config.sections import (
    JpegRange,
    MotionRange,
    PsfRange,
    Section,
    Share,
    Weight,
    Weighted,
    WellRange,
)


class LightSettings(Weighted):
    """Weights of the kinds of light."""

    constant: Weight = 0.2
    """Even light from everywhere. In full 0.05."""

    area: Weight = 0.5
    """One square lamp and a dim surround. In full 0.15."""

    room: Weight = 0.3
    """A room's ceiling lamp and window; before a wall, two lamps near the ceiling. In full 0.4."""

    lamp: Weight = 0.0
    """One lamp and next to nothing else: deep shadows. In full 0.12."""

    sky: Weight = 0.0
    """Sun and sky (Hosek-Wilkie), clear to overcast. In full 0.28."""

    hdri: Weight = 0.0
    """A panorama of yours: `files.hdri`."""


class BackgroundSettings(Weighted):
    """Weights of the kinds of background."""

    plain: Weight = 0.3
    """A wall of one colour. In full 0.03."""

    procedural: Weight = 0.5
    """A wall with a procedural texture. In full 0.06."""

    room: Weight = 0.2
    """A room around hand and cameras; `things.furniture` fills it. In full 0.62."""

    empty: Weight = 0.0
    """Nothing: depth 0, `valid` false; the surround's light shows. For compositing; cheapest."""

    outdoor: Weight = 0.0
    """Open ground with things on it, under a sky. In full 0.29."""

    photo: Weight = 0.0
    """A picture of yours on the wall behind the hand: `files.images`."""


class ThingSettings(Section):
    """Objects in the scene; shares of samples."""

    furniture: Share = 0.0
    """Share of rooms and outdoor places that are furnished. In full 1."""

    support: Share = 0.0
    """Share of samples whose hand or arm rests on a table, where the camera allows it. In full
    0.45."""

    occluder: Share = 0.0
    """Share of samples with an object between camera and hand. In full 0.2."""


class WearSettings(Section):
    """What is worn; shares of samples."""

    sleeve: Share = 0.0
    """In full 0.4."""

    ring: Share = 0.0
    """In full 0.2."""

    bracelet: Share = 0.0
    """In full 0.1."""

    watch: Share = 0.0
    """In full 0.1."""


class OpticsSettings(Section):
    """The lens and the shutter."""

    distortion: float = Field(default=0.0, ge=0.0, le=0.2)
    """Largest radial displacement at the frame's corner, as a share of its distance from the image
    centre; barrel and pincushion alike, but a lens that would fold the picture over is weakened.
    Image and labels are both distorted. In full 0.02."""

    defocus: Share = 0.0
    """Share of samples with a shallow depth of field, focused on the hand. In full 0.25."""

    motion: Share = 0.0
    """Share of samples that move while the shutter is open. Labels belong to its middle. In full
    0.15."""

    motion_px: MotionRange = (2.0, 10.0)
    """Length of the motion in the picture, pixels at 256 px width, [lowest, highest]."""


class SensorSettings(Section):
    """From radiance to the picture; in plain an ideal camera, automatic exposure alone."""

    exposure_ev: float = Field(default=0.0, ge=0.0, le=3.0)
    """Standard deviation of the exposure's error, stops. In full 0.25."""

    white_balance: bool = False
    """Take the light's colour out, as cameras do. In full true."""

    balance_error: float = Field(default=0.0, ge=0.0, le=0.5)
    """Standard deviation of what is left over, per channel, relative. In full 0.03."""

    psf_px: PsfRange = (0.0, 0.0)
    """Optical blur, standard deviation, pixels, [lowest, highest]. In full [0.35, 0.7]."""

    full_well: WellRange = (0.0, 0.0)
    """Electrons at white, which set shot noise, [lowest, highest], log-uniform; 0 leaves noise
    out. In full [2000, 30000]."""

    read_e: float = Field(default=0.0, ge=0.0, le=100.0)
    """Read noise, electrons. In full 4."""

    bayer: bool = False
    """Sample through a colour mosaic and demosaic. In full true."""

    sharpen: float = Field(default=0.0, ge=0.0, le=2.0)
    """Largest share of the unsharp mask; drawn from 0 up. In full 0.5."""

    bloom: float = Field(default=0.0, ge=0.0, le=0.5)
    """Share of light beyond white that spreads. In full 0.06."""

    jpeg: JpegRange = (0, 0)
    """Quality of the stored JPEG, percent, [lowest, highest]; 0 takes `corpus.jpeg_quality`. In
    full [82, 96]."""


class FileSettings(Section):
    """Your own light and pictures; their licence is recorded in every sample that uses them."""

    hdri: str | None = Field(default=None, min_length=1, max_length=4096)
    """Panorama (.exr, latitude-longitude) or a folder of them, for `light.hdri`."""

    images: str | None = Field(default=None, min_length=1, max_length=4096)
    """Picture (.jpg, .png) or a folder of them, for `background.photo`."""

    licence: str = Field(default="", max_length=200)
    """Under which terms you may use them; required with either."""

    @model_validator(mode="after")
    def _licence_stated(self) -> Self:
        if (self.hdri or self.images) and not self.licence.strip():
            raise ValueError(
                "files.licence is empty; state the terms of your pictures, for example "
                "files.licence=CC0 or 'own work'"
            )
        return self
