"""The scanner of the self-test and what stands before it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from synthgen.config import load_config
from synthgen.geometry.normals import unit
from synthgen.sampling import stream
from synthgen.sampling.draw import draw_sample
from synthgen.scanner import Effects, ScanScene, ScanSettings, load_rig, settings_for
from synthgen.scanner.evaluate import coverage, seen_by_pairs, surface_samples
from synthgen.scanner.hand import HandSolid, hand_solid, put_in_rig
from synthgen.scanner.pipeline import Measurement, measure
from synthgen.scanner.rig import Rig, only
from synthgen.scanner.stage import Stage, prepare

MATT = Effects(specular=False, subsurface=False, defocus=False, bounce=False)
"""No error but those of the sensors and of the matcher."""


def rig(seed: int = 0, units: Any = None, *, exact: bool = True) -> Rig:
    """Return hand5; ``exact`` knows its true calibration and fires all units at once."""
    found = load_rig("hand5", seed)
    if exact:
        known = tuple(replace(u, true=u.nominal) for u in found.units)
        found = replace(found, units=known, sync_s=0.0)
    return found if units is None else only(found, units)


def settings(of: Rig, level: Any = "full", **changes: Any) -> ScanSettings:
    """Return the level's settings without colour, with the truth of every pixel."""
    asked: dict[str, Any] = {"colour": False, "true_disparity": True, **changes}
    return replace(settings_for(of, level), **asked)


def keyed(seed: int = 0) -> np.random.Generator:
    """Return the generator of one scan."""
    return stream(seed, "sample", 0, 0, "benchmark")


def staged(solids: Any, of: Rig, seed: int = 0, effects: Effects = MATT) -> Stage:
    """Put solids before a scanner."""
    return prepare(ScanScene(tuple(solids)), of, rng=keyed(seed), effects=effects)


def front(solids: Any, of: Rig, seed: int = 0, **changes: Any) -> tuple[Stage, Measurement]:
    """Let the front unit alone measure solids, with nine light samples per pixel."""
    stage = staged(solids, of, seed)
    return stage, measure(stage, of.units[0], "full", settings(of, **{"spp": 9, **changes}))


def axes(of: Rig) -> Any:
    """Right, up and towards the first pair, columns (3, 3)."""
    left, right = (c.position for c in (of.units[0].nominal.left, of.units[0].nominal.right))
    ahead, aside = unit((left + right) / 2), unit(right - left)
    return np.stack([aside, np.cross(ahead, aside), ahead], axis=1)


def hand(index: int = 0, spin: float = 0.0, asked: Any = (), *, flat: bool = True) -> HandSolid:
    """Return a hand in the rig, its back to the front unit; flat, or in its sampled pose."""
    keys = ["pose.gmm_share=1", "model.hands=right", *asked]
    subject = draw_sample(load_config("hand_rgbd", keys), index).scene.subjects[0]
    if flat:
        straight = tuple([subject.pose[0], *[(0.0, 0.0, 0.0)] * 15])
        subject = replace(subject, pose=straight)
    return hand_solid(put_in_rig(subject, spin))


def covered(found: Any, stage: Any, held: HandSolid, of: Any) -> tuple[float, float]:
    """Shares of the seen and of the never-seen skin that a scan has within 1 mm."""
    skin = held.solid.faces[held.source >= 0][::3]
    points, normals, areas = surface_samples(held.solid.vertices, skin)
    seen = seen_by_pairs(stage, of.units, points, normals)
    return coverage(found, points, areas, seen, 1e-3)


def fused_rms(found: Any) -> float:
    """RMS of a scan's signed errors, clipped at 2 mm, millimetres."""
    error = 1e3 * found.provenance["error_m"]
    return float(np.sqrt(np.mean(np.clip(error, -2, 2) ** 2)))
