"""The schema of a configuration: what may be set, in which unit and range, and what it means.

The docstring under a field is its documentation, printed by ``synthgen config schema``.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from synthgen.config.places import (
    BackgroundSettings,
    FileSettings,
    LightSettings,
    OpticsSettings,
    SensorSettings,
    ThingSettings,
    WearSettings,
)
from synthgen.config.quality import in_quality
from synthgen.config.sections import FillRange, FovRange, Section
from synthgen.config.skin import SkinSettings

Column = Literal["image", "depth", "labels", "meta", "exr", "scan", "stereo"]
COLUMNS: tuple[Column, ...] = ("image", "depth", "labels", "meta", "exr", "scan", "stereo")
ScannerEffect = Literal[
    "shadows", "specular", "subsurface", "defocus", "bounce", "shot_noise", "read_noise",
    "pixel_gains", "hot_pixels", "saturation", "quantisation",
]  # fmt: skip


class ModelSettings(Section):
    """Which hand."""

    name: str = Field(default="cc0-hand", min_length=1, max_length=4096)
    """Name of a hand model (``synthgen models list``) or path of a MANO ``.npz``, ``.pkl``."""

    hands: Literal["both", "left", "right"] = "both"
    """Side: ``both`` draws left and right with equal chance."""


class SubjectSettings(Section):
    """Whose hands."""

    count: int | None = Field(default=None, ge=1, le=10**9)
    """Number of different people (shape and skin); null gives every sample its own."""


class ShapeSettings(Section):
    """Shape of the hand: betas, independent normal, truncated."""

    sigma: float = Field(default=1.0, gt=0.0, le=3.0)
    """Standard deviation of each beta before truncation; 1 is the model's population."""

    limit: float = Field(default=3.0, gt=0.0, le=5.0)
    """Largest absolute beta."""


class PoseSettings(Section):
    """Pose of the fingers, always within the model's joint limits."""

    gmm_share: float = Field(default=0.7, ge=0.0, le=1.0)
    """Share of poses from the Gaussian mixture; the rest are uniform over the joint limits."""

    gmm_components: int = Field(default=10, ge=1, le=50)
    """Number of Gaussians, fitted to the pose table in the model's file."""

    pca_components: int = Field(default=15, ge=1, le=45)
    """Leading principal components of the pose in which the mixture lives."""

    penetration_limit_m: float = Field(default=0.003, ge=0.0, le=0.02)
    """Deepest allowed self-penetration, metres; deeper poses are drawn again."""


class OrientationSettings(Section):
    """How the hand is turned towards the first camera."""

    mode: Literal["uniform", "cone"] = "uniform"
    """``uniform`` on SO(3), or the back of the hand within a ``cone`` about the camera."""

    cone_deg: float = Field(default=60.0, gt=0.0, le=180.0)
    """Half angle of the cone, degrees; used with mode ``cone``."""


class CameraSettings(Section):
    """Where the cameras are and what they see."""

    views: int = Field(default=1, ge=1, le=16)
    """Number of cameras around the hand."""

    fov_deg: FovRange = (25.0, 60.0)
    """Field of view over the longer side of the frame, degrees, [lowest, highest]."""

    fill: FillRange = (0.5, 0.85)
    """Share of the frame's shorter side that the hand spans, [lowest, highest]; less where a wide
    lens would come nearer to it than 8 cm."""

    offset: float = Field(default=0.06, ge=0.0, le=0.5)
    """Largest offset of the hand's centre from the image centre, as a share of the frame."""


class RenderSettings(Section):
    """Size and effort of a picture."""

    width: int = Field(default=256, ge=16, le=8192)
    """Width, pixels."""

    height: int = Field(default=256, ge=16, le=8192)
    """Height, pixels."""

    spp: int = Field(default=16, ge=1, le=4096)
    """Light paths per pixel; labels always come from one ray through the pixel's centre."""

    quality: Literal["plain", "full"] = "plain"
    """``full`` turns on every ingredient of the look that is not set otherwise: skin in detail,
    places, things, what is worn, lens and sensor. ``plain`` leaves them off."""

    max_depth: int = Field(default=3, ge=2, le=32)
    """Longest light path, segments; 2 is direct light only. In full 4."""

    denoise: Literal["auto", "oidn", "none"] = "none"
    """Denoiser of the linear picture: ``oidn`` needs the extra `denoise`; ``auto`` takes it where
    it is installed. The choice is resolved in the plan. In full auto."""

    diffusion: bool = False
    """Spread light under the skin, in the picture. In full true."""

    sensor_depth: Literal["off", "model", "half", "full"] = "off"
    """What a D4xx-like depth camera at each view reports, beside the exact depth: `full` projects
    dots and matches pictures, `half` does so with half the pixels along each edge, `model` adds
    errors fitted to `full`; the rig is `consumer`."""

    variant: Literal["auto", "llvm_ad_rgb", "cuda_ad_rgb"] = "auto"
    """Mitsuba variant; ``auto`` takes CUDA where it works and LLVM elsewhere."""


def _columns(columns: tuple[Column, ...]) -> tuple[Column, ...]:
    missing = [name for name in ("image", "labels", "meta") if name not in columns]
    if missing:
        raise ValueError(
            f"{', '.join(missing)} missing; only depth, exr, scan and stereo may be left out"
        )
    if len(set(columns)) != len(columns):
        raise ValueError("a column is named twice")
    return tuple(name for name in COLUMNS if name in columns)


def _once(names: tuple[ScannerEffect, ...]) -> tuple[ScannerEffect, ...]:
    if len(set(names)) != len(names):
        raise ValueError("an effect is named twice")
    return names


class ScannerSettings(Section):
    """A speckle scanner around the hand; needs the column scan, and stereo for its pictures."""

    rig: str | None = Field(default=None, min_length=1, max_length=4096)
    """Name of a rig (``scenes/rigs``) or path of a YAML file, whose content is then part of what
    decides the bytes; null scans nothing."""

    level: Literal["full", "half", "model"] = "full"
    """Full or half resolution, or `model`: no pictures, errors from a fitted noise model."""

    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Scanner seed: one frozen draw of calibration errors, slides and sensor flaws."""

    preset: Literal["default", "best"] = "default"
    """Matching: `best` refines with a quadratic shape function, fewer outliers for more time."""

    without: Annotated[tuple[ScannerEffect, ...], AfterValidator(_once)] = ()
    """What is left out, all else equal. Light: shadows, specular, subsurface, defocus, bounce.
    Sensors: shot_noise, read_noise, pixel_gains, hot_pixels, saturation, quantisation."""

    speed_m_s: float = Field(default=0.0, ge=0, le=2.0)
    """How fast the hand moves while it is scanned, in a direction of its own; units do not fire at
    quite the same time."""


class CorpusSettings(Section):
    """How the corpus is stored."""

    shard_size: int = Field(default=250, ge=1, le=100_000)
    """Samples per shard: the unit of work, of commit and of resuming."""

    columns: Annotated[tuple[Column, ...], AfterValidator(_columns)] = COLUMNS[:4]
    """What is written: image, labels and meta always; depth unless left out; if asked exr (linear,
    float depth), scan (coloured mesh) and stereo (rectified speckle pairs, disparities,
    calibration)."""

    jpeg_quality: int = Field(default=95, ge=50, le=100)
    """Quality of the JPEG pictures, percent."""


class Config(Section):
    """Everything that decides a corpus; with the seed it decides every byte."""

    seed: int = Field(default=0, ge=0, le=2**63 - 1)
    """Seed of every random stream; 0 is a seed like any other."""

    samples: int = Field(default=32, ge=1, le=10**9)
    """Number of samples; not part of the hash, so a corpus can grow."""

    model: ModelSettings = ModelSettings()
    subjects: SubjectSettings = SubjectSettings()
    shape: ShapeSettings = ShapeSettings()
    pose: PoseSettings = PoseSettings()
    orientation: OrientationSettings = OrientationSettings()
    camera: CameraSettings = CameraSettings()
    light: LightSettings = LightSettings()
    background: BackgroundSettings = BackgroundSettings()
    things: ThingSettings = ThingSettings()
    wear: WearSettings = WearSettings()
    skin: SkinSettings = SkinSettings()
    optics: OpticsSettings = OpticsSettings()
    sensor: SensorSettings = SensorSettings()
    files: FileSettings = FileSettings()
    render: RenderSettings = RenderSettings()
    scanner: ScannerSettings = ScannerSettings()
    corpus: CorpusSettings = CorpusSettings()

    @model_validator(mode="after")
    def _filled_by_quality(self) -> Self:
        for name, section in in_quality(self, self.render.quality).items():
            self.__dict__[name] = section  # frozen to everybody else
        return self

    @model_validator(mode="after")
    def _files_given(self) -> Self:
        for weight, given, key in (
            (self.light.hdri, self.files.hdri, "light.hdri needs files.hdri"),
            (self.background.photo, self.files.images, "background.photo needs files.images"),
        ):
            if weight > 0 and not given:
                raise ValueError(f"{key}, a file or folder of yours, and files.licence")
        return self

    @model_validator(mode="after")
    def _scans_need_a_rig(self) -> Self:
        asked = [name for name in ("scan", "stereo") if name in self.corpus.columns]
        if asked and self.scanner.rig is None:
            raise ValueError(f"corpus.columns has {asked[0]} but scanner.rig is null; name a rig")
        pictured = self.scanner.preset != "default" or self.scanner.without
        if self.scanner.level == "model" and pictured:
            raise ValueError("scanner.level model has no light and no matching: leave out "
                             "scanner.preset and scanner.without")  # fmt: skip
        if self.scanner.rig is not None and "scan" not in self.corpus.columns:
            raise ValueError("scanner.rig is set; add scan to corpus.columns, or set it to null")
        if "stereo" in asked and self.scanner.level == "model":
            raise ValueError("scanner.level model takes no pictures: leave the column stereo out")
        if self.render.sensor_depth != "off" and "depth" not in self.corpus.columns:
            raise ValueError("render.sensor_depth is stored in the column depth; add it")
        return self
