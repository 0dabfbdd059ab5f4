"""What a quality turns on: the values of settings that a configuration leaves open."""

from __future__ import annotations

from typing import Any

from synthgen.config.sections import Section

FULL: dict[str, dict[str, Any]] = {
    "skin": {"detail": True, "relief_m": 0.002, "varnish": 0.06},
    "light": {"constant": 0.05, "area": 0.15, "room": 0.4, "lamp": 0.12, "sky": 0.28},
    "background": {"plain": 0.03, "procedural": 0.06, "room": 0.62, "outdoor": 0.29},
    "things": {"furniture": 1.0, "support": 0.45, "occluder": 0.2},
    "wear": {"sleeve": 0.4, "ring": 0.2, "bracelet": 0.1, "watch": 0.1},
    "optics": {"distortion": 0.02, "defocus": 0.25, "motion": 0.15},
    "sensor": {
        "exposure_ev": 0.25,
        "white_balance": True,
        "balance_error": 0.03,
        "psf_px": (0.35, 0.7),
        "full_well": (2000.0, 30000.0),
        "read_e": 4.0,
        "bayer": True,
        "sharpen": 0.5,
        "bloom": 0.06,
        "jpeg": (82, 96),
    },
    "render": {"max_depth": 4, "denoise": "auto", "diffusion": True},
}


def in_quality(config: Section, quality: str) -> dict[str, Section]:
    """Return the sections that a quality changes, with every setting that was given kept."""
    changed = {}
    for name, values in (FULL if quality == "full" else {}).items():
        section = getattr(config, name)
        missing = {k: v for k, v in values.items() if k not in section.model_fields_set}
        changed[name] = section.model_copy(update=missing)
    return changed
