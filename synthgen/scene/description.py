"""Frozen description of what stands before the sensors; knows no renderer.

Everything is plain floats, ints, strings and tuples, so that a scene is a row of JSON and equal
scenes compare equal. World frame: right-handed, y up, floor at y = 0, metres.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from synthgen.geometry.cameras import Camera

Vec3 = tuple[float, float, float]
Hand = Literal["left", "right"]


@dataclass(frozen=True)
class Skin:
    """Look of one person's skin; colours are linear sRGB reflectance in 0..1.

    Attributes
    ----------
    dorsal_rgb, palm_rgb, nail_rgb : Vec3
        Mean albedo of the zones.
    roughness : float
        Of the principled material, on the back of the hand.
    mottle : float
        Relative standard deviation of the albedo's solid noise.
    seed : int
        Key of everything random within the skin.
    melanin, blood : float
        Volume fractions in epidermis and dermis, back of the hand.
    eumelanin, carotene : float
        Share of eumelanin in the melanin; strength of the carotene bands.
    freckles : float
        Share of freckle sites that are taken, 0..1.
    veins, creases : float
        Gains of the veins' and creases' colour and relief; 0 removes them.
    sweat : float
        0 dry, 1 moist: gloss.
    relief_m : float
        Largest distance of the drawn surface from the model's smooth surface (tendons, knuckles,
        wrist bones, veins), metres; 0 draws the model's surface itself.
    detail : bool
        Drawn from baked maps under a bump map, or smooth in three colours.
    varnish_rgb : Vec3 or None
        Paint on the nails.
    """

    dorsal_rgb: Vec3
    palm_rgb: Vec3
    nail_rgb: Vec3
    roughness: float
    mottle: float
    seed: int
    melanin: float = 0.03
    blood: float = 0.019
    eumelanin: float = 0.8
    carotene: float = 1.4
    freckles: float = 0.0
    veins: float = 0.6
    creases: float = 1.0
    sweat: float = 0.1
    relief_m: float = 0.0
    detail: bool = False
    varnish_rgb: Vec3 | None = None


@dataclass(frozen=True)
class HandSubject:
    """One posed hand with its arm.

    Attributes
    ----------
    subject_id : int
        Identity (shape and skin belong to it); several samples may share one.
    model : str
        Name or path understood by ``synthgen.models.load``.
    hand : {"left", "right"}
        Side; left hands are stored as left hands, not mirrored.
    shape : tuple of float
        Betas, (nb,), unit variance.
    pose : tuple of Vec3
        (K, 3) axis-angle, radians, mean pose included; row 0 is the root (about joint 0).
    translation_m : Vec3
        Added after posing, world metres.
    wrist, elbow : Vec3
        Axis-angle of the forearm relative to the hand, and of the upper arm relative to it.
    skin : Skin
    sleeve : Sleeve or None
    bands : tuple of Band
        Rings, bracelets and watches.
    """

    subject_id: int
    model: str
    hand: Hand
    shape: tuple[float, ...]
    pose: tuple[Vec3, ...]
    translation_m: Vec3
    wrist: Vec3
    elbow: Vec3
    skin: Skin
    sleeve: Sleeve | None = None
    bands: tuple[Band, ...] = ()


@dataclass(frozen=True)
class Sleeve:
    """Cloth around the arm, from ``start_m`` behind the wrist upwards.

    ``slack_m`` is its clearance from the skin, ``fold_m`` the amplitude of its folds; ``seed`` keys
    folds and pattern; colours are linear reflectances.
    """

    start_m: float
    slack_m: float
    fold_m: float
    colour_rgb: Vec3
    accent_rgb: Vec3
    pattern: Literal["plain", "stripes", "checks"]
    seed: int


@dataclass(frozen=True)
class Band:
    """Something worn around an arm or a finger.

    Attributes
    ----------
    kind : {"ring", "bracelet", "watch"}
    finger : int
        Model joint whose bone a ring sits on (1, 4, 7, 10 or 13); 0 for the wrist.
    place : float
        Metres behind the wrist; for a ring the share of the bone, from its joint.
    width_m, thickness_m : float
    colour_rgb : Vec3
        Linear reflectance; of metal where ``metal`` is true.
    """

    kind: Literal["ring", "bracelet", "watch"]
    finger: int
    place: float
    width_m: float
    thickness_m: float
    colour_rgb: Vec3
    metal: bool


@dataclass(frozen=True)
class Thing:
    """A solid that stands in the scene.

    Attributes
    ----------
    role : {"furniture", "support", "occluder"}
        Occluders have an instance of their own in the labels; the rest is background.
    shape : str
        ``box``, or a turned body: ``cylinder``, ``ball``, ``bottle``, ``bowl``, ``cone``.
    position_m : Vec3
        Centre, world.
    turn : Vec3
        Axis-angle, radians.
    size_m : Vec3
        Full extents along its own x, y (the axis of turned bodies) and z.
    colour_rgb, accent_rgb : Vec3
        Linear reflectances of its pattern, keyed by ``seed``.
    roughness : float
        0.05 glossy .. 1 matt.
    """

    role: Literal["furniture", "support", "occluder"]
    shape: Literal["box", "cylinder", "ball", "bottle", "bowl", "cone"]
    position_m: Vec3
    turn: Vec3
    size_m: Vec3
    colour_rgb: Vec3
    accent_rgb: Vec3
    roughness: float
    seed: int


@dataclass(frozen=True)
class Picture:
    """A file of the user's: absolute path, SHA-256 of its bytes, and the licence they state."""

    path: str
    sha256: str
    licence: str


@dataclass(frozen=True)
class AreaLight:
    """Square one-sided lamp at ``position_m`` facing ``target_m``; edge ``size_m``."""

    position_m: Vec3
    target_m: Vec3
    size_m: float
    radiance_rgb: Vec3


@dataclass(frozen=True)
class Sky:
    """Light from a map of the whole sphere, in place of the constant surround.

    Without ``file``: sun and sky of Hosek-Wilkie form at ``sun_direction`` (unit, towards the sun)
    and ``turbidity`` (2 clear .. 10 hazy); ``sun_share`` scales the sun alone (cloud: near 0).
    With ``file``: the user's panorama, turned by ``turn_rad`` about y. Either is scaled so that a
    surface facing the brightest half receives ``irradiance``, in the units in which a white
    constant surround of radiance 1 gives pi.
    """

    sun_direction: Vec3
    turbidity: float
    sun_share: float
    irradiance: float
    turn_rad: float = 0.0
    file: Picture | None = None


@dataclass(frozen=True)
class Lights:
    """A constant surround or a sky, plus any number of area lights (0-3)."""

    constant_rgb: Vec3
    area: tuple[AreaLight, ...] = ()
    sky: Sky | None = None


@dataclass(frozen=True)
class Background:
    """What fills the rest of the picture.

    ``plain``, ``procedural`` and ``photo``: one wall facing the first camera, ``distance_m``
    behind the point (``centre_m``) that it looks at; ``room``: an axis-aligned box around
    ``centre_m`` whose walls are ``distance_m`` away in x and z (plus ``stretch_m``), floor at
    y = 0, ceiling at ``ceiling_m``; ``outdoor``: the ground at y = 0 under the sky; ``empty``:
    nothing. ``seed`` keys the procedural texture; ``colour_rgb`` and ``accent_rgb`` are linear
    reflectances; ``file`` is what a ``photo`` shows, shifted by ``crop`` (0..1, 0..1).
    """

    kind: Literal["plain", "procedural", "room", "empty", "outdoor", "photo"]
    colour_rgb: Vec3
    accent_rgb: Vec3
    seed: int
    distance_m: float
    centre_m: Vec3
    ceiling_m: float = 2.5
    stretch_m: tuple[float, float] = (0.0, 0.0)
    file: Picture | None = None
    crop: tuple[float, float] = (0.5, 0.5)


@dataclass(frozen=True)
class Motion:
    """Rigid motion of the subjects while the shutter is open, about ``centre_m``.

    Labels belong to the middle of the exposure: the motion runs from -1/2 to +1/2 of
    ``shift_m`` (world) and ``turn`` (axis-angle, radians), drawn as ``steps`` sub-frames.
    """

    centre_m: Vec3
    shift_m: Vec3
    turn: Vec3
    steps: int


@dataclass(frozen=True)
class Optics:
    """Thin lens of one view: radius of the aperture (0 pinhole) and distance in focus, metres."""

    aperture_m: float = 0.0
    focus_m: float = 1.0


@dataclass(frozen=True)
class Sensor:
    """From radiance to the stored picture.

    Attributes
    ----------
    exposure_ev : float
        Error of the automatic exposure, stops.
    white_balance : bool
        Whether the light's colour is taken out; ``balance_error`` (3,) are the factors left over.
    psf_px : float
        Standard deviation of the optical blur, 0 none.
    full_well : float
        Electrons at white, before balance; 0 leaves noise out. Read noise ``read_e`` electrons.
    bayer : bool
        Sample through an RGGB mosaic and demosaic.
    sharpen : float
        Share of an unsharp mask.
    bloom : float
        Share of light beyond white that spreads.
    jpeg_quality : int
        Of the stored picture; 0 takes the corpus's.
    seed : int
        Of the noise.
    """

    exposure_ev: float = 0.0
    white_balance: bool = False
    balance_error: Vec3 = (1.0, 1.0, 1.0)
    psf_px: float = 0.0
    full_well: float = 0.0
    read_e: float = 0.0
    bayer: bool = False
    sharpen: float = 0.0
    bloom: float = 0.0
    jpeg_quality: int = 0
    seed: int = 0


@dataclass(frozen=True)
class Scene:
    """Subjects, cameras (one view each), lights and background, and how they are taken.

    ``optics`` has one entry per camera, or none for pinholes.
    """

    subjects: tuple[HandSubject, ...]
    cameras: tuple[Camera, ...]
    lights: Lights
    background: Background
    things: tuple[Thing, ...] = ()
    motion: Motion | None = None
    optics: tuple[Optics, ...] = ()
    sensor: Sensor = Sensor()


def to_json(scene: Scene) -> dict[str, Any]:
    """Return ``scene`` as nested dicts and lists of JSON types."""
    return dataclasses.asdict(scene)


def from_json(row: dict[str, Any]) -> Scene:
    """Rebuild the scene that :func:`to_json` wrote; equal to the original."""
    subjects = tuple(_subject(s) for s in row["subjects"])
    lit, back, motion = row["lights"], row["background"], row["motion"]
    sky = lit["sky"]
    return Scene(
        subjects=subjects,
        cameras=tuple(Camera(**_tuples(c)) for c in row["cameras"]),
        lights=Lights(
            constant_rgb=_tuple(lit["constant_rgb"]),
            area=tuple(AreaLight(**_tuples(a)) for a in lit["area"]),
            sky=None if sky is None else Sky(**{**_tuples(sky), "file": _picture(sky["file"])}),
        ),
        background=Background(**{**_tuples(back), "file": _picture(back["file"])}),
        things=tuple(Thing(**_tuples(t)) for t in row["things"]),
        motion=None if motion is None else Motion(**_tuples(motion)),
        optics=tuple(Optics(**o) for o in row["optics"]),
        sensor=Sensor(**_tuples(row["sensor"])),
    )


def _subject(row: dict[str, Any]) -> HandSubject:
    sleeve = row["sleeve"]
    worn = {
        "skin": Skin(**_tuples(row["skin"])),
        "sleeve": None if sleeve is None else Sleeve(**_tuples(sleeve)),
        "bands": tuple(Band(**_tuples(b)) for b in row["bands"]),
    }
    return HandSubject(**{**_tuples(row), **worn})


def _picture(row: dict[str, Any] | None) -> Picture | None:
    return None if row is None else Picture(**row)


def _tuple(value: Any) -> Any:
    return tuple(_tuple(v) for v in value) if isinstance(value, list | tuple) else value


def _tuples(row: dict[str, Any]) -> dict[str, Any]:
    return {key: _tuple(value) for key, value in row.items()}
