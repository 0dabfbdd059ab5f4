"""Zones and textures of the skin as functions of the rest position: palms, knuckles, mottle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.geometry.nearest import nearest
from synthgen.render.skin.noise import solid_noise
from synthgen.render.skin.sites import Sites
from synthgen.sampling.streams import stream
from synthgen.scene.anatomy import Anatomy
from synthgen.scene.relief import bump
from synthgen.scene.veins import curve, vein_field

Values = NDArray[np.float32]

FRECKLE_SITES = 900
FRECKLE_REACH_MM = 3.0
_CELLS, _FURROW_M = 60_000, 0.00022


@dataclass(frozen=True, eq=False)
class Zones:
    """Where the skin is of another kind; (n,) float32, 0..1.

    ``palm``; ``inner`` side of the forearm; ``knuckle`` backs of joints; ``tip`` of fingers;
    ``pad`` cushions of the palm; ``vein``.
    """

    palm: Values
    inner: Values
    knuckle: Values
    tip: Values
    pad: Values
    vein: Values


def lay_zones(sites: Sites, anatomy: Anatomy) -> Zones:
    """Lay out the zones of a hand and arm."""
    fingers = np.stack([sites.finger_weight(f) for f in range(5)])
    facing = -sites.normals[:, 1]
    facing = _round_arm(sites, facing)
    thumb, back = fingers[4], anatomy.fingers[4].back.astype(np.float32)
    facing = facing * (1 - thumb) - thumb * (sites.normals @ back)
    wander = 0.12 * solid_noise(sites.points, 0.02, "palm border", 3)
    # The palm's skin runs out over 2 cm at the wrist, not in a line.
    along = -sites.points[:, 0] + 0.05 * wander
    palm = _step(facing + wander, -0.12, 0.52) * _step(along, -0.010, 0.016)
    arm = _step(-along, -0.012, 0.03)
    inner = _step(facing + 0.5 * wander, -0.3, 0.7) * arm
    tips = np.stack([f.points[3] - 0.003 * f.back for f in anatomy.fingers])
    pads = _pads(anatomy)
    return Zones(
        palm=palm,
        inner=inner,
        knuckle=_knuckles(sites, anatomy, fingers) * (1 - palm),
        tip=_near(sites.points, tips, 0.012),
        pad=_near(sites.points, pads, 0.012) * palm,
        vein=np.asarray(_veins(sites, anatomy, inner), np.float32),
    )


def _round_arm(sites: Sites, facing: Values) -> Values:
    """Towards the wrist, go by the place around the arm: bones make its skin face any way."""
    x, y, z = sites.points.T
    arm = np.abs(x - 0.005) < 0.01
    centre = np.median(sites.points[arm], axis=0) if arm.any() else np.zeros(3)
    around = -(y - centre[1]) / np.maximum(np.hypot(y - centre[1], 0.75 * (z - centre[2])), 1e-4)
    share = _step(x, -0.035, -0.005)
    return np.asarray(facing + share * (around - facing), dtype=np.float32)


def _knuckles(sites: Sites, anatomy: Anatomy, fingers: Values) -> Values:
    """Backs of the joints, where skin is loose, darker and redder."""
    strength = np.zeros(len(sites.points), np.float32)
    for number, finger in enumerate(anatomy.fingers):
        own = np.flatnonzero(fingers[number] > 0.15)
        points, share = sites.points[own], np.clip((fingers[number][own] - 0.15) * 2, 0, 1)
        dorsal = _step(sites.normals[own] @ finger.back.astype(np.float32), -0.1, 0.7)
        for k, (gain, radius) in enumerate(((0.8, 0.010), (1.0, 0.0085), (0.65, 0.007))):
            if finger.is_thumb and k == 0:
                continue
            away = np.linalg.norm(points - _over(finger.points[k], finger.back), axis=1)
            spot = bump(away, radius + 0.004)
            strength[own] = np.maximum(strength[own], gain * spot * dorsal * share)
    return strength


def _over(joint: Any, back: Any) -> Values:
    return np.asarray(joint + 0.006 * back, dtype=np.float32)


def _pads(anatomy: Anatomy) -> NDArray[np.float64]:
    """Cushions below the fingers, of the thumb and of the little finger's side."""
    by_name = {f.name: f.points for f in anatomy.fingers}
    down = np.array([0.0, -0.012, 0.0])
    names = ("index", "middle", "ring", "pinky")
    roots = [by_name[name][0] + down for name in names]
    thenar = 0.5 * (by_name["thumb"][0] + by_name["thumb"][1]) + 0.6 * down
    hypothenar = 0.45 * by_name["pinky"][0] + np.array([0.0, -0.012, -0.008])
    return np.stack([*roots, thenar, hypothenar, 0.7 * thenar + 0.3 * hypothenar])


def _veins(sites: Sites, anatomy: Anatomy, inner: Values) -> NDArray[np.float64]:
    """Lay the net on the back and, in colour alone, the veins of the inner wrist."""
    back = vein_field(sites.points, sites.normals, sites.weights, anatomy)
    t = np.linspace(0, 1, 8)[:, None]
    lines = []
    for k, (z0, z1) in enumerate(((0.014, 0.022), (0.002, -0.004), (-0.010, -0.02))):
        sway = 0.003 * np.sin(5 * t + 2 * k)
        lines.append(curve(np.hstack([-0.005 + 0.16 * t, z0 + (z1 - z0) * t + sway]), 0.0005))
    away, _ = nearest(np.concatenate(lines), sites.points[:, [0, 2]], 0.006)
    under = bump(np.minimum(away, 1.0), 0.0019) * _step(inner, 0.3, 0.8)
    broken = np.clip(0.6 + 0.5 * solid_noise(sites.points, 0.03, "vein depth"), 0.1, 1)
    return np.asarray(np.clip(np.maximum(back, 0.7 * under) * broken, 0, 1))


@dataclass(frozen=True, eq=False)
class Grain:
    """Texture within a zone, (n,).

    ``big``, ``middle``, ``fine`` and ``pigment`` are noise of unit deviation; ``cell`` 0..1 lies in
    the furrows between skin cells; ``relief`` is fine relief, millimetres; ``freckle`` and
    ``freckle_mm`` are the nearest freckle site and its distance.
    """

    big: Values
    middle: Values
    fine: Values
    pigment: Values
    cell: Values
    relief: Values
    freckle: NDArray[np.uint16]
    freckle_mm: Values


def lay_grain(sites: Sites, palm: Values, plate: Values) -> Grain:
    """Lay out the skin's texture; ``plate`` (n,) are the nails, which have none."""
    points = sites.points
    furrow = _furrows(sites)
    bare = 1 - plate
    soft = (1 - 0.55 * palm) * bare
    stretched = points * np.array([1.0, 1.0, 2.2], dtype=np.float32)
    relief = -0.042 * furrow * soft
    relief += 0.020 * solid_noise(points, 0.0016, "relief fine", 2) * soft
    relief += 0.032 * solid_noise(stretched, 0.0035, "relief", 2) * bare * (0.6 + 0.4 * palm)
    relief += 0.05 * solid_noise(points, 0.010, "relief soft", 2) * bare * (1 - palm)
    freckle, away = _freckles(sites)
    return Grain(
        big=solid_noise(points, 0.035, "big", 2),
        middle=solid_noise(points, 0.009, "middle", 3),
        fine=solid_noise(points, 0.0026, "fine", 2),
        pigment=solid_noise(points, 0.012, "pigment", 3),
        cell=furrow * bare,
        relief=relief,
        freckle=freckle,
        freckle_mm=away,
    )


def _furrows(sites: Sites) -> Values:
    """Borders between cells about a millimetre wide: where the two nearest seeds are as far."""
    rng = stream(0, "corpus", 0, 0, "skin cells")
    seeds = sites.points[rng.permutation(len(sites.points))[:_CELLS]]
    seeds = seeds + (rng.normal(size=seeds.shape) * 2e-4).astype(np.float32)
    found: Any = cKDTree(seeds).query(sites.points, k=2)
    away = found[0]
    apart = away[:, 1] - away[:, 0]
    width = sites.width(_FURROW_M)
    return np.asarray(bump(apart, width) * min(1.0, _FURROW_M / width), np.float32)


def _freckles(sites: Sites) -> tuple[NDArray[np.uint16], Values]:
    rng = stream(0, "corpus", 0, 0, "freckle sites")
    seeds = sites.points[rng.permutation(len(sites.points))[:FRECKLE_SITES]]
    away, found = nearest(seeds, sites.points, FRECKLE_REACH_MM * 1e-3)
    off = ~np.isfinite(away)
    number = np.where(off, 0, found).astype(np.uint16)
    return number, np.where(off, FRECKLE_REACH_MM, away * 1e3).astype(np.float32)


def _step(x: Any, low: float, high: float) -> Values:
    t = np.clip((np.asarray(x, np.float32) - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), dtype=np.float32)


def _near(points: Values, places: Any, radius: float) -> Values:
    """Highest of Gaussian spots around places (m, 3)."""
    spots = [np.linalg.norm(points - np.asarray(p, np.float32), axis=1) for p in places]
    return np.asarray(bump(np.min(spots, axis=0), radius), dtype=np.float32)
