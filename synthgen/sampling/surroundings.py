"""Everything around a placed subject, each part from a random stream of its own.

So that switching one part leaves every other as it was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.config import Config
from synthgen.errors import SamplingError
from synthgen.geometry.cameras import Camera
from synthgen.sampling import placement, sensing, things
from synthgen.sampling.backgrounds import sample_background
from synthgen.sampling.furniture import furniture
from synthgen.sampling.lighting import sample_lights
from synthgen.sampling.stage import Stage
from synthgen.sampling.streams import Streams
from synthgen.scene import Background, Lights, Motion, Optics, Picture, Sensor, Thing
from synthgen.scene.files import Kind, candidates, checked

Array = NDArray[np.float64]

SKIES = ("sky", "hdri")


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The rest of a scene, and what of it is worth a column."""

    cameras: tuple[Camera, ...]
    lights: Lights
    background: Background
    things: tuple[Thing, ...]
    motion: Motion | None
    optics: tuple[Optics, ...]
    sensor: Sensor
    factors: dict[str, float | int | str]


def surround(config: Config, stage: Stage, streams: Streams) -> Surroundings:
    """Draw lights, background, things, optics, motion and sensor of one sample."""
    wall, background = _background(config, stage, streams("background"))
    light, lights = _lights(config, stage, background, streams("light"))
    around = _things(config, stage, background, streams)
    optics = sensing.sample_optics(config.optics, stage.cameras, stage.hand, rng=streams("optics"))
    motion = sensing.sample_motion(
        config.optics, stage.cameras[0], stage.hand, rng=streams("motion")
    )
    roles = [thing.role for thing in around]
    used = [f for f in (background.file, lights.sky.file if lights.sky else None) if f is not None]
    return Surroundings(
        cameras=sensing.distorted(
            stage.cameras, config.optics.distortion, stage.end, rng=streams("distortion")
        ),
        lights=lights,
        background=background,
        things=around,
        motion=motion,
        optics=optics,
        sensor=sensing.sample_sensor(config.sensor, rng=streams("sensor")),
        factors={
            "light": light,
            "background": wall,
            "support": int("support" in roles),
            "occluder": int("occluder" in roles),
            "things": len(around),
            "motion": int(motion is not None),
            "defocus": int(any(o.aperture_m > 0 for o in optics)),
            **({"licence": used[0].licence} if used else {}),
        },
    )


def _background(config: Config, stage: Stage, rng: np.random.Generator) -> tuple[str, Background]:
    kind = choose(config.background.weights(), rng)
    camera = stage.cameras[0]
    centre = stage.hand.mean(axis=0)
    eyes = np.array([camera.position for camera in stage.cameras])
    behind = placement.depth_behind(stage.surface, camera)
    behind -= placement.depth_behind(centre[None], camera)
    picture = None
    if kind == "photo":
        picture = _file(str(config.files.images), "image", config.files.licence, rng)
    return kind, sample_background(kind, centre, behind, eyes, rng=rng, picture=picture)


def _lights(
    config: Config, stage: Stage, background: Background, rng: np.random.Generator
) -> tuple[str, Lights]:
    kind = choose(config.light.weights(), rng)
    if background.kind == "room" and kind not in ("room", "lamp"):
        kind = "room"  # no surround shines into a closed room
    if background.kind == "outdoor" and kind not in SKIES:
        kind = "hdri" if config.light.hdri > 0 else "sky"
    panorama = None
    if kind == "hdri":
        panorama = _file(str(config.files.hdri), "panorama", config.files.licence, rng)
    centre = stage.hand.mean(axis=0)
    eye = stage.cameras[0].position
    return kind, sample_lights(kind, centre, eye, background, rng=rng, panorama=panorama)


def _file(place: str, kind: Kind, licence: str, rng: np.random.Generator) -> Picture:
    found = candidates(place, kind)
    return checked(found[int(rng.integers(len(found)))], kind, licence)


def _things(
    config: Config, stage: Stage, background: Background, streams: Streams
) -> tuple[Thing, ...]:
    settings = config.things
    found: tuple[Thing, ...] = ()
    table, before, filled = streams("support"), streams("occluder"), streams("furniture")
    near = background.kind in ("room", "outdoor")
    if table.random() < settings.support and near:
        found += things.support(stage, rng=table)
    if before.random() < settings.occluder:
        found += things.occluder(stage, rng=before)
    if filled.random() < settings.furniture and near:
        found += furniture(stage, background, rng=filled)
    return things.within_slots(found)


def choose(weights: dict[str, float], rng: np.random.Generator) -> str:
    """Draw a name by its weight.

    Raises
    ------
    SamplingError
        If every weight is 0.
    """
    names = sorted(weights)
    total = sum(weights.values())
    if total <= 0:
        raise SamplingError(f"all weights of {names} are 0; give at least one a positive weight")
    edges = np.cumsum([weights[name] for name in names]) / total
    return names[min(int(np.searchsorted(edges, rng.random(), side="right")), len(names) - 1)]
