"""What stands before the sensors, described without any renderer."""

from synthgen.scene.description import (
    AreaLight,
    Background,
    HandSubject,
    Lights,
    Scene,
    Skin,
    from_json,
    to_json,
)

__all__ = [
    "AreaLight",
    "Background",
    "HandSubject",
    "Lights",
    "Scene",
    "Skin",
    "from_json",
    "to_json",
]
