"""What stands before the sensors, described without any renderer."""

from synthgen.scene.description import (
    AreaLight,
    Background,
    Band,
    HandSubject,
    Lights,
    Motion,
    Optics,
    Picture,
    Scene,
    Sensor,
    Skin,
    Sky,
    Sleeve,
    Thing,
    from_json,
    to_json,
)

__all__ = [
    "AreaLight",
    "Background",
    "Band",
    "HandSubject",
    "Lights",
    "Motion",
    "Optics",
    "Picture",
    "Scene",
    "Sensor",
    "Skin",
    "Sky",
    "Sleeve",
    "Thing",
    "from_json",
    "to_json",
]
