"""The schema of ``scenes/rigs/*.yaml``: what a scanner is, in units and ranges.

Angles in degrees and lengths in metres, since people write these files. The docstring under a
field is its documentation.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from synthgen.config.sections import Section
from synthgen.scanner.rig import MIN_PIXELS

MAX_ROWS = 8
_Length = Annotated[float, Field(gt=0.0, le=20.0)]
_Offset = Annotated[float, Field(ge=-20.0, le=20.0)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_K = Annotated[float, Field(ge=-2.0, le=2.0)]
_Offset3 = tuple[_Offset, _Offset, _Offset]
_Ident = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,32}$")]


class CameraSpec(Section):
    """One kind of camera."""

    width: int = Field(ge=MIN_PIXELS, le=8192)
    """Pixels."""

    height: int = Field(ge=MIN_PIXELS, le=8192)
    """Pixels."""

    gsd_m: float = Field(gt=0.0, le=0.1)
    """Size of a pixel on the target, metres: it sets the focal length, distance / gsd."""

    distortion: tuple[_K, _K, _K, _K, _K] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Brown-Conrady k1 k2 p1 p2 k3, as OpenCV."""


class PairSpec(Section):
    """The stereo pair of every unit."""

    camera: CameraSpec
    """Both cameras."""

    baseline_m: _Length
    """Distance of the two centres."""

    axes: Literal["toed_in", "shifted", "parallel"] = "toed_in"
    """Both axes meet at the target; or they are parallel, with shifted sensors that both have the
    target in the middle, or with centred ones."""


class ColourSpec(Section):
    """The colour camera of every unit."""

    camera: CameraSpec

    offset_m: _Offset3 = (0.0, 0.0, 0.0)
    """Of its centre from the unit's: right, up, forward."""


class PatternSpec(Section):
    """The slide of a projector."""

    kind: Literal["speckle", "dots", "laser", "image"] = "speckle"
    """Band-limited noise, dots on a jittered lattice, laser speckle, or a picture."""

    dot_m: float = Field(default=0.0008, gt=0.0, le=0.1)
    """Full width at half maximum of a blob on the target, metres."""

    fill: float = Field(default=0.5, gt=0.01, lt=0.99)
    """Share that is bright (``speckle``, ``dots``)."""

    slides: int = Field(default=4, ge=1, le=64)
    """Number of different slides; the projectors take them in turn."""

    image: str = Field(default="", max_length=4096)
    """Path of a picture (``image``); a relative one starts at the rig's file."""

    @model_validator(mode="after")
    def _image_where_asked(self) -> Self:
        if (self.kind == "image") != bool(self.image):
            raise ValueError("`image` names a file with kind: image, and only then")
        return self


class ProjectorSpec(Section):
    """Optics of a projector; where it stands is given with the unit or under ``projectors``."""

    field_m: _Length
    """Edge of the lit square on the target."""

    pattern: PatternSpec = PatternSpec()

    irradiance: float = Field(default=0.5, ge=0.0, le=1e6)
    """At the focus distance, facing, where the slide is bright; a white surface has radiance 1
    under 1. It falls with the square of the distance."""

    aperture_m: float = Field(default=0.025, ge=0.0, le=0.5)
    """Diameter of the lens: blur grows with the distance from the focus; 0 is sharp."""

    focus_offset_m: _Offset = 0.0
    """Focus behind (positive) or before the target."""

    vignetting: float = Field(default=4.0, ge=0.0, le=8.0)
    """Falls with cos of the angle to this power; 0 is off."""


class SensorSpec(Section):
    """How a camera turns light into counts; every effect has a value that switches it off."""

    exposure_s: float = Field(default=0.0015, gt=0.0, le=1.0)
    line_delay_s: float = Field(default=0.0, ge=0.0, le=1e-3)
    """Between two rows' starts; 0 is a global shutter."""

    psf_px: float = Field(default=0.5, ge=0.0, le=5.0)
    """Sigma of the blur; 0 is off."""

    full_well_e: float = Field(default=10_000.0, ge=100.0, le=1e7)
    """Electrons at saturation: shot noise is their square root."""

    shot_noise: bool = True
    read_noise_e: float = Field(default=8.0, ge=0.0, le=1000.0)
    prnu: float = Field(default=0.005, ge=0.0, le=0.2)
    """Relative sigma of the pixels' gains, frozen per scanner."""

    hot_share: float = Field(default=1e-5, ge=0.0, le=0.1)
    """Share of stuck bright pixels, frozen per scanner."""

    saturation: bool = True
    """False: counts go on beyond full scale; the coarse search and stored pictures end there."""

    bits: Literal[8, 10, 12] = 8
    quantisation: bool = True
    """False: counts have fractions; the coarse search and stored pictures have none."""

    black_dn: float = Field(default=2.0, ge=0.0, le=64.0)
    """Offset in counts of an 8-bit sensor."""

    gain: float | None = Field(default=None, gt=0.0, le=1e6)
    """Full wells per unit of radiance; null is automatic."""

    auto_target: float = Field(default=0.8, gt=0.0, le=2.0)
    """Automatic: where the 99 % quantile of the subject lands, as a share of full scale."""

    vignetting: float = Field(default=0.0, ge=0.0, le=8.0)


class LightSpec(Section):
    """Light that is not speckle."""

    ambient: float = Field(default=0.05, ge=0.0, le=1e3)
    """Even irradiance while speckle is on."""

    background: float = Field(default=0.002, ge=0.0, le=1e3)
    """Radiance where nothing stands."""

    white_m: tuple[_Offset3, ...] = ()
    """Positions of the white panels for colour pictures; empty is an even surround."""

    white_size_m: _Length = 0.2
    white_delay_s: float = Field(default=0.0, ge=0.0, le=1.0)
    """Colour is taken this much after speckle."""


class ErrorSpec(Section):
    """Sigmas by which the true cameras differ from nominal; one draw per scanner seed."""

    focal: float = Field(default=1e-4, ge=0.0, le=0.1)
    principal_px: float = Field(default=0.05, ge=0.0, le=20.0)
    rotation_rad: float = Field(default=2.5e-5, ge=0.0, le=0.1)
    translation_m: float = Field(default=2.5e-5, ge=0.0, le=0.1)
    k1: float = Field(default=0.0, ge=0.0, le=0.5)
    unit_rotation_rad: float = Field(default=0.0, ge=0.0, le=0.1)
    unit_translation_m: float = Field(default=0.0, ge=0.0, le=0.1)
    epipolar_limit_px: float = Field(default=0.4, gt=0.0, le=20.0)
    """Draws with more than this in some unit are refused and drawn again, since rows that do not
    correspond cannot be matched; see ``reconstruction.rows``."""


class GlassSpec(Section):
    """A transparent floor."""

    top_m: _Offset
    thickness_m: float = Field(gt=0.0, le=0.2)
    ior: float = Field(default=1.52, ge=1.0, le=3.0)


class ReconstructionSpec(Section):
    """Settings of reconstruction that belong to the rig."""

    matcher: Literal["sgbm", "census"] = "sgbm"
    window_px: int = Field(default=13, ge=5, le=41)
    """Edge of the windows that are compared; odd."""

    stride_px: int = Field(default=3, ge=1, le=8)
    voxel_m: float = Field(default=0.0008, gt=1e-5, le=0.1)

    rows: int = Field(default=0, ge=0, le=MAX_ROWS)
    """Rows above and below that points are looked for in, with the matcher sgbm: for calibrations
    whose rows do not correspond. Draws up to half as many pixels of epipolar RMS are then taken.
    0 trusts the calibration."""

    @model_validator(mode="after")
    def _windows_have_a_middle(self) -> Self:
        if self.window_px % 2 == 0:
            raise ValueError(f"window_px {self.window_px} is even; a window needs a middle pixel")
        return self

    @model_validator(mode="after")
    def _rows_are_searched_by_sgbm(self) -> Self:
        if self.rows and self.matcher != "sgbm":
            raise ValueError("`rows` needs matcher: sgbm; a census matcher trusts its calibration")
        return self


class PlaceSpec(Section):
    """Where something stands, by the point that it looks at."""

    azimuth_deg: float = Field(ge=-360.0, le=360.0)
    """About y, from +z (in front) towards +x."""

    elevation_deg: float = Field(ge=-90.0, le=90.0)
    """Above the target; negative is below."""

    distance_m: _Length
    target_m: _Offset3 = (0.0, 0.0, 0.0)
    roll_deg: float = Field(default=0.0, ge=-360.0, le=360.0)
    """About the line of sight: 90 stands a pair upright."""

    slot: int = Field(default=0, ge=0, le=63)
    """Time slot: what shares a slot works together."""


class RigSpec(Section):
    """One scanner."""

    summary: str = Field(min_length=1, max_length=200)
    volume_m: tuple[_Length, _Length, _Length]
    """Edges of the working volume about the origin."""

    own_choices: tuple[Annotated[str, Field(max_length=80)], ...] = ()
    """Keys whose values no paper gives: our choice."""

    pair: PairSpec
    colour: ColourSpec | None = None
    projector: ProjectorSpec
    """Optics of every projector."""

    unit_projectors_m: tuple[_Offset3, ...] = ()
    """Projectors of each unit, offsets of their centres from the unit's: right, up, forward."""

    units: dict[_Ident, PlaceSpec] = Field(min_length=1, max_length=64)
    projectors: dict[_Ident, PlaceSpec] = Field(default={}, max_length=64)
    """Projectors that stand alone."""

    grey_sensor: SensorSpec = SensorSpec()
    colour_sensor: SensorSpec = SensorSpec()
    light: LightSpec = LightSpec()
    glass: GlassSpec | None = None
    sync_s: float = Field(default=0.0, ge=0.0, le=1.0)
    """Units fire within plus or minus this of one another."""

    slot_s: float = Field(default=0.01, ge=0.0, le=10.0)
    fps: float = Field(default=1.0, gt=0.0, le=1000.0)
    error: ErrorSpec = ErrorSpec()
    reconstruction: ReconstructionSpec = ReconstructionSpec()
