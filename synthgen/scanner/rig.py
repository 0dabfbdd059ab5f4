"""What a scanner is made of: units, cameras, projectors, sensors, glass; frozen and plain.

Frame: the rig's own, right-handed, y up, metres, origin at the centre of the working volume.
Every camera is known twice: the *nominal* calibration is what reconstruction may know, the *true*
one makes the pictures. They differ by one frozen draw per scanner seed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

from synthgen.errors import ConfigError, nearest
from synthgen.geometry.cameras import Camera
from synthgen.render.readout import Readout

Vec3 = tuple[float, float, float]
Role = Literal["left", "right", "colour"]
PatternKind = Literal["speckle", "dots", "laser", "image"]
MAX_PROJECTORS, MIN_PIXELS = 64, 16


@dataclass(frozen=True)
class Calibration:
    """Cameras of one unit; ``colour`` is None where the unit has none."""

    left: Camera
    right: Camera
    colour: Camera | None

    def camera(self, role: Role) -> Camera:
        """Return one camera; raises ConfigError for a colour camera that is not there."""
        found: Camera | None = getattr(self, role)
        if found is None:
            raise ConfigError("the unit has no colour camera; ask for 'left' or 'right'")
        return found


@dataclass(frozen=True)
class Unit:
    """One stereo pair with its colour camera.

    Attributes
    ----------
    ident : str
        Unique in the rig.
    index : int
        Row in ``rig.units``; keys the unit's random streams.
    nominal, true : Calibration
        What reconstruction knows, and what makes the pictures.
    slot : int
        Time slot in which the unit exposes; projectors of the same slot light it.
    """

    ident: str
    index: int
    nominal: Calibration
    true: Calibration
    slot: int


@dataclass(frozen=True)
class Pattern:
    """What a projector's slide shows, values 0..1.

    Attributes
    ----------
    kind : {"speckle", "dots", "laser", "image"}
        Band-limited random speckle with soft edges; round dots on a jittered lattice; the
        intensity of a complex Gaussian field; a picture of the user's.
    dot_px : float
        Size of a blob (full width at half maximum), texels.
    fill : float
        Share of the slide that is bright, 0..1 (``speckle`` and ``dots``).
    seed : int
        Of the slide; frozen, it belongs to the scanner.
    image : str
        Path of the picture (``image``), else empty.
    """

    kind: PatternKind
    dot_px: float
    fill: float
    seed: int
    image: str = ""


@dataclass(frozen=True)
class Projector:
    """One speckle projector.

    Attributes
    ----------
    ident : str
        Unique in the rig; ``"unit/0"`` for a unit's own.
    optics : Camera
        Pose and intrinsics of a camera that looks where the projector shines; its pixels are the
        texels of the slide.
    pattern : Pattern
    irradiance : float
        On a surface that faces the projector on its axis at ``focus_m``, where the slide is 1;
        relative units in which a white Lambertian surface under irradiance 1 has radiance 1. It
        falls with the square of the distance.
    focus_m, aperture_m : float
        Distance in focus and diameter of the lens; 0 aperture is sharp everywhere.
    vignetting : float
        Irradiance falls with cos**vignetting of the angle off the axis; 0 is off, 4 is natural.
    slot : int
        Time slot in which it is on.
    """

    ident: str
    optics: Camera
    pattern: Pattern
    irradiance: float
    focus_m: float
    aperture_m: float
    vignetting: float
    slot: int


@dataclass(frozen=True)
class Sensor:
    """How a camera turns light into counts.

    Attributes
    ----------
    exposure_s, line_delay_s : float
        Exposure; time between the starts of two rows, 0 is a global shutter.
    psf_px : float
        Sigma of the lens and pixel blur beyond the pixel's own box; 0 is off.
    full_well_e : float
        Electrons at saturation.
    shot_noise : bool
    read_noise_e : float
        Sigma of the read noise, electrons.
    prnu : float
        Relative sigma of the pixels' gains, frozen per scanner.
    hot_share : float
        Share of pixels that are stuck bright, frozen per scanner.
    saturation : bool
        False: counts go on beyond full scale; the coarse search and stored pictures end there.
    bits : int
        8, 10 or 12.
    quantisation : bool
        False: counts have fractions; the coarse search and stored pictures have none.
    black_dn : float
        Offset added before quantisation, counts of an 8-bit sensor.
    gain : float or None
        Full wells per unit of radiance; None is automatic: the unit's cameras together have
        their 99 % quantile of the subject at ``auto_target`` of full scale.
    auto_target : float
    vignetting : float
        Radiance falls with cos**vignetting of the angle off the camera's axis.
    """

    exposure_s: float
    line_delay_s: float
    psf_px: float
    full_well_e: float
    shot_noise: bool
    read_noise_e: float
    prnu: float
    hot_share: float
    saturation: bool
    bits: int
    quantisation: bool
    black_dn: float
    gain: float | None
    auto_target: float
    vignetting: float

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return self.readout.full_scale

    @property
    def readout(self) -> Readout:
        """The part of it that turns light into counts, as every camera here does."""
        return Readout(
            self.full_well_e, self.shot_noise, self.read_noise_e, self.prnu, self.hot_share,
            saturation=1.0 if self.saturation else math.inf, bits=self.bits,
            black_dn=self.black_dn, quantisation=self.quantisation,
        )  # fmt: skip


@dataclass(frozen=True)
class Glass:
    """A plane-parallel slab (a floor) whose normal is y; devices below ``top_m`` look through it.

    Attributes
    ----------
    top_m, thickness_m : float
        Height of the upper face, and thickness.
    ior : float
        Refractive index against air.
    """

    top_m: float
    thickness_m: float
    ior: float


@dataclass(frozen=True)
class Light:
    """Light that is not speckle.

    Attributes
    ----------
    ambient : float
        Even irradiance on everything while speckle is on, same unit as a projector's.
    background : float
        Radiance where nothing is hit.
    white : tuple of Vec3
        Positions of the white panels (flash) that light the colour pictures, metres.
    white_size_m : float
        Edge of a panel.
    white_delay_s : float
        Colour pictures are taken this much after speckle.
    """

    ambient: float
    background: float
    white: tuple[Vec3, ...]
    white_size_m: float
    white_delay_s: float


@dataclass(frozen=True)
class CalibrationError:
    """Sigmas of the draw by which true cameras differ from nominal ones; independent per camera.

    Attributes
    ----------
    focal : float
        Relative.
    principal_px : float
        Per axis, pixels.
    rotation_rad, translation_m : float
        Per axis.
    k1 : float
    unit_rotation_rad, unit_translation_m : float
        Rigid pose of a whole unit about the centre of the volume.
    epipolar_limit_px : float
        Draws with a larger epipolar RMS in some unit are refused and drawn again; where
        reconstruction looks over neighbouring rows, at least half as many pixels as rows.
    """

    focal: float
    principal_px: float
    rotation_rad: float
    translation_m: float
    k1: float
    unit_rotation_rad: float
    unit_translation_m: float
    epipolar_limit_px: float


@dataclass(frozen=True)
class Reconstruction:
    """Settings of reconstruction that belong to the rig.

    Attributes
    ----------
    matcher : {"sgbm", "census"}
        OpenCV SGBM with DIC refinement, or census with semi-global matching as in consumer cameras.
    window_px, stride_px : int
        DIC window and spacing of the points.
    voxel_m : float
        Edge of the fusion voxels.
    rows : int
        How many rows above and below points are looked for; 0 trusts the calibration's rows.
    """

    matcher: Literal["sgbm", "census"]
    window_px: int
    stride_px: int
    voxel_m: float
    rows: int


@dataclass(frozen=True)
class Rig:
    """A scanner.

    Attributes
    ----------
    name, summary : str
        Of the file, and one line about it.
    seed : int
        Scanner seed: one calibration draw, one set of slides, one fixed pattern per sensor.
    units : tuple of Unit
    projectors : tuple of Projector
        All of the rig, at most 64.
    grey, colour : Sensor
        Of the stereo cameras and of the colour cameras.
    light : Light
    volume_m : Vec3
        Edges of the working volume, a box about the origin.
    glass : Glass or None
    sync_s : float
        Units fire within plus or minus this time of one another, drawn per scan; 0 is exact.
    slot_s : float
        Time from one slot to the next.
    fps : float
        Frames per second.
    error : CalibrationError
    epipolar_px : tuple of float
        Epipolar RMS of each unit over the working volume, true against nominal, pixels.
    draws : int
        Calibration draws until one was within the limit.
    reconstruction : Reconstruction
    own_choices : tuple of str
        Keys of the file whose values the papers do not give.
    digest : str
        SHA-256 of what the file and its picture say, whatever the file is called.
    """

    name: str
    summary: str
    seed: int
    units: tuple[Unit, ...]
    projectors: tuple[Projector, ...]
    grey: Sensor
    colour: Sensor
    light: Light
    volume_m: Vec3
    glass: Glass | None
    sync_s: float
    slot_s: float
    fps: float
    error: CalibrationError
    epipolar_px: tuple[float, ...]
    draws: int
    reconstruction: Reconstruction
    own_choices: tuple[str, ...]
    digest: str

    def unit(self, ident: str) -> Unit:
        """Return a unit by its id; raises ConfigError with the nearest match."""
        for unit in self.units:
            if unit.ident == ident:
                return unit
        known = [unit.ident for unit in self.units]
        raise ConfigError(
            f"rig {self.name} has no unit {ident!r}{nearest(ident, known)}; it has "
            f"{', '.join(known)}"
        )

    def sensor(self, role: Role) -> Sensor:
        """Return the sensor behind a unit's camera."""
        return self.colour if role == "colour" else self.grey

    def lit_by(self, unit: Unit) -> tuple[Projector, ...]:
        """Return the projectors that are on while a unit exposes."""
        return tuple(p for p in self.projectors if p.slot == unit.slot)


def only(rig: Rig, idents: Iterable[str]) -> Rig:
    """Return the rig with only some of its units; projectors and streams stay as they were."""
    return replace(rig, units=tuple(rig.unit(ident) for ident in idents))
