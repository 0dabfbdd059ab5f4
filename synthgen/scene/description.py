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


@dataclass(frozen=True)
class AreaLight:
    """Square one-sided lamp at ``position_m`` facing ``target_m``; edge ``size_m``."""

    position_m: Vec3
    target_m: Vec3
    size_m: float
    radiance_rgb: Vec3


@dataclass(frozen=True)
class Lights:
    """A constant surround plus any number of area lights (0-3)."""

    constant_rgb: Vec3
    area: tuple[AreaLight, ...] = ()


@dataclass(frozen=True)
class Background:
    """What fills the rest of the picture.

    ``plain`` and ``procedural``: one wall facing the first camera, ``distance_m`` behind the
    point (``centre_m``) that it looks at; ``room``: an axis-aligned box around ``centre_m`` whose
    walls are ``distance_m`` away, floor at y = 0; ``empty``: nothing. ``seed`` keys the
    procedural texture; ``colour_rgb`` and ``accent_rgb`` are linear reflectances.
    """

    kind: Literal["plain", "procedural", "room", "empty"]
    colour_rgb: Vec3
    accent_rgb: Vec3
    seed: int
    distance_m: float
    centre_m: Vec3


@dataclass(frozen=True)
class Scene:
    """Subjects, cameras (one view each), lights and background."""

    subjects: tuple[HandSubject, ...]
    cameras: tuple[Camera, ...]
    lights: Lights
    background: Background


def to_json(scene: Scene) -> dict[str, Any]:
    """Return ``scene`` as nested dicts and lists of JSON types."""
    return dataclasses.asdict(scene)


def from_json(row: dict[str, Any]) -> Scene:
    """Rebuild the scene that :func:`to_json` wrote; equal to the original."""
    subjects = tuple(
        HandSubject(**{**_tuples(s), "skin": Skin(**_tuples(s["skin"]))}) for s in row["subjects"]
    )
    cameras = tuple(Camera(**_tuples(c)) for c in row["cameras"])
    area = tuple(AreaLight(**_tuples(a)) for a in row["lights"]["area"])
    lights = Lights(constant_rgb=_tuple(row["lights"]["constant_rgb"]), area=area)
    return Scene(subjects, cameras, lights, Background(**_tuples(row["background"])))


def _tuple(value: Any) -> Any:
    return tuple(_tuple(v) for v in value) if isinstance(value, list | tuple) else value


def _tuples(row: dict[str, Any]) -> dict[str, Any]:
    return {key: _tuple(value) for key, value in row.items()}
