"""Creases: wrinkles over the backs of joints, folds on the palm side, lines of palm and wrist.

Laid out from joint axes on the rest pose. Wrinkles flatten and folds deepen as a joint bends, so
the two are kept apart, with the joint that rules each place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.nearest import nearest
from synthgen.geometry.normals import unit
from synthgen.render.skin.noise import solid_noise
from synthgen.render.skin.sites import Sites
from synthgen.sampling.streams import stream
from synthgen.scene.anatomy import Anatomy, Finger
from synthgen.scene.relief import bump
from synthgen.scene.veins import curve

Array = NDArray[np.float64]
Values = NDArray[np.float32]

_REACH_M = 0.020


@dataclass(frozen=True, eq=False)
class Creases:
    """Per place (n,).

    Attributes
    ----------
    wrinkles, folds, lines : float32
        Heights, millimetres: backs of joints, palm sides of joints, palm and wrist.
    tint : float32
        How much of a crease is there, 0..1: darker and redder skin.
    joint : uint8
        Joint that rules wrinkles and folds there; 0 none.
    """

    wrinkles: Values
    folds: Values
    lines: Values
    tint: Values
    joint: NDArray[np.uint8]


def lay_creases(sites: Sites, anatomy: Anatomy) -> Creases:
    """Lay out every crease of a hand."""
    n = len(sites.points)
    wrinkles, folds, tint = (np.zeros(n, np.float32) for _ in range(3))
    joint = np.zeros(n, np.uint8)
    sway = solid_noise(sites.points, 0.006, "crease sway", 2)
    for number, finger in enumerate(anatomy.fingers):
        weight = sites.finger_weight(number)
        own = np.flatnonzero(weight > 0.2)
        share = np.clip((weight[own] - 0.2) * 2.5, 0, 1)
        for k in range(3):
            around = _around(sites, finger, k, own, sway)
            near = np.abs(around.u) < _REACH_M
            rows = own[near]
            up, down = _joint_creases(around, finger, k, sites)
            wrinkles[rows] += up[near] * share[near]
            folds[rows] += down[near] * share[near]
            closest = np.abs(around.u) < 0.5 * _neighbour_distance(finger, k)
            joint[own[closest & (share > 0)]] = finger.joints[k]
    lines, line_tint = _palm_lines(sites, anatomy)
    tint += np.clip(-1.3 * wrinkles, 0, 0.8) + np.clip(-2.6 * folds, 0, 1) + line_tint
    return Creases(wrinkles, folds, lines, np.clip(tint, 0, 1), joint)


@dataclass(frozen=True, eq=False)
class _Around:
    """Places around a joint: along the finger (m), angle from its back (rad)."""

    u: Values
    phi: Values
    sway: Values


def _around(sites: Sites, finger: Finger, k: int, own: NDArray[np.int64], sway: Values) -> _Around:
    bones = unit(np.diff(finger.points, axis=0))
    axis = unit(bones[max(k - 1, 0)] + bones[k])
    back = unit(finger.back - (finger.back @ axis) * axis)
    offset = sites.points[own] - finger.points[k].astype(np.float32)
    u = offset @ axis.astype(np.float32)
    phi = np.arctan2(offset @ np.cross(axis, back), offset @ back)
    return _Around(u, phi.astype(np.float32), sway[own])


def _neighbour_distance(finger: Finger, k: int) -> float:
    """Length of the shorter bone at a joint."""
    lengths = np.linalg.norm(np.diff(finger.points, axis=0), axis=1)
    return float(min(lengths[max(k - 1, 0)], lengths[k]))


def _joint_creases(a: _Around, finger: Finger, k: int, sites: Sites) -> tuple[Values, Values]:
    """Heights of the wrinkles on a joint's back and of the folds on its palm side, mm."""
    palmar = np.asarray(np.pi - np.abs(a.phi), dtype=np.float32)
    if k == 0 or (finger.is_thumb and k == 1):
        return _knuckle_wrinkles(a, finger, k, sites), _digit_fold(a, finger, k, palmar, sites)
    middle = k == 1 or finger.is_thumb
    return _wrinkles(a, finger, k, middle, sites), _fold(a, middle, palmar, sites)


def _wrinkles(a: _Around, finger: Finger, k: int, middle: bool, sites: Sites) -> Values:
    """Bowed lines over the back of a joint, on the pad of loose skin that carries them."""
    rng = stream(0, "corpus", 0, 0, f"wrinkles/{finger.name}/{k}")
    count, pitch, depth = (4, 0.0021, 0.54) if middle else (2, 0.0016, 0.36)
    bow = 0.40 + 0.60 * np.cos(np.clip(a.phi * 1.15, -1.5, 1.5))
    height = np.zeros(len(a.u), np.float32)
    for i in range(-count, count + 1):
        at = i * pitch * bow + 0.0004 * rng.standard_normal()
        at = at + (0.0003 + 0.0002 * rng.random()) * a.sway
        width = sites.width(0.00034 + 0.00014 * rng.random())
        reach = bump(a.phi + 0.22 * rng.standard_normal(), 0.62 + 0.3 * rng.random())
        gain = np.exp(-((i / (0.75 * count)) ** 2)) * rng.uniform(0.5, 1.0)
        height -= depth * gain * bump(a.u - at, width) * reach
    pad = 0.22 if middle else 0.10
    return np.asarray(height + pad * bump(a.u, 0.0055) * bump(a.phi, 0.8), dtype=np.float32)


def _knuckle_wrinkles(a: _Around, finger: Finger, k: int, sites: Sites) -> Values:
    """Faint cross lines over a knuckle and the web beside it."""
    rng = stream(0, "corpus", 0, 0, f"knuckle/{finger.name}/{k}")
    height = np.zeros(len(a.u), np.float32)
    for i in range(-3, 4):
        at = i * 0.0026 + 0.0006 * rng.standard_normal() + 0.0007 * a.sway
        width = sites.width(0.0005)
        gain = rng.uniform(0.4, 1.0) * np.exp(-((i / 2.6) ** 2))
        height -= 0.20 * gain * bump(a.u - at, width) * bump(a.phi + 0.2 * i % 0.3, 0.8)
    return height


def _fold(a: _Around, middle: bool, palmar: Values, sites: Sites) -> Values:
    """Fold opposite a joint: double at the middle joint, single at the last."""
    bow = a.u + 0.0005 * np.cos(2 * palmar) + 0.00035 * a.sway
    width = sites.width(0.00045)
    if middle:
        line = bump(bow - 0.0012, width) + 0.8 * bump(bow + 0.0013, width)
    else:
        line = bump(bow, width) + 0.3 * bump(bow + 0.0016, sites.width(0.0004))
    broken = np.clip(0.8 + 0.25 * a.sway, 0.2, 1.1)
    return np.asarray(-0.34 * line * bump(palmar, 1.15) * broken, dtype=np.float32)


def _digit_fold(a: _Around, finger: Finger, k: int, palmar: Values, sites: Sites) -> Values:
    """Fold at a finger's root, about half way along the first bone; the thumb's at its joint."""
    bone = float(np.linalg.norm(finger.points[k + 1] - finger.points[k]))
    share = (0.10 if k == 1 else 9.0) if finger.is_thumb else 0.56
    u = a.u - share * bone + 0.00035 * a.sway
    width = sites.width(0.0005)
    second = 0.75 if finger.name in ("middle", "ring") else 0.3
    line = bump(u - 0.0012, width) + second * bump(u + 0.0013, width)
    return np.asarray(-0.32 * line * bump(palmar, 1.0), dtype=np.float32)


def _palm_lines(sites: Sites, anatomy: Anatomy) -> tuple[Values, Values]:
    """Heights (mm) and tint of the lines of palm and wrist."""
    n = len(sites.points)
    height, tint = np.zeros(n, np.float32), np.zeros(n, np.float32)
    facing = -sites.normals[:, 1]
    fingers = np.stack([sites.finger_weight(f) for f in range(4)]).max(axis=0)
    mask = np.clip((facing - 0.1) / 0.4, 0, 1) * np.clip((0.8 - fingers) / 0.3, 0, 1)
    own = np.flatnonzero((mask > 0.01) & (sites.weights[:, 16] < 0.5))
    warp = [solid_noise(sites.points[own], 0.025, f"palm warp/{k}", 2) for k in range(2)]
    plan = sites.points[own][:, [0, 2]] + 0.0008 * np.stack(warp, axis=1)
    fading = np.clip(0.72 + 0.4 * solid_noise(sites.points[own], 0.011, "palm fading", 2), 0.1, 1.1)
    for points, gain, width in _palm_curves(anatomy):
        away, at = nearest(points, plan, 0.004)
        found = np.flatnonzero(np.isfinite(away))
        end = np.minimum(at[found], len(points) - 1 - at[found]) / len(points)
        taper = np.clip(end / 0.16, 0, 1) ** 0.7
        # Narrow at the tips, broader in the middle, as a fold is.
        line = bump(away[found], sites.width(width) * (0.55 + 0.45 * taper))
        deep = gain * line * taper * (mask[own] * fading)[found]
        height[own[found]] -= (0.36 * deep).astype(np.float32)
        # A fold also draws the skin around it in a little.
        height[own[found]] -= (0.10 * gain * bump(away[found], 0.0018) * taper).astype(np.float32)
        thin = bump(away[found], sites.width(0.6 * width) * (0.5 + 0.5 * taper))
        mark = 0.75 * gain * thin * taper * (mask[own] * fading)[found]
        tint[own[found]] = np.maximum(tint[own[found]], mark)
    wrist_height, wrist_tint = _wrist_lines(sites, facing)
    return height + wrist_height, np.clip(tint + wrist_tint, 0, 1)


def _palm_curves(anatomy: Anatomy) -> list[tuple[Array, float, float]]:
    """Centre lines (m, 2) in the plane (x, z), gain and half width (m) of each line."""
    first = {f.name: f.points[0] for f in anatomy.fingers}
    length = -float(first["middle"][0])
    zi, zp = float(first["index"][2]), float(first["pinky"][2])
    mid = (zi + zp) / 2
    named: list[tuple[list[tuple[float, float]], float, float]] = [
        ([(0.80, zp - 0.013), (0.84, zp + 0.004), (0.90, mid - 0.012), (1.02, mid + 0.004),
          (1.13, zi * 0.62)], 0.95, 0.0004),
        ([(0.90, zi + 0.013), (0.83, zi - 0.004), (0.70, mid), (0.56, zp + 0.004)], 0.85, 0.00038),
        ([(0.90, zi + 0.013), (0.80, zi), (0.60, zi - 0.014), (0.36, zi - 0.022),
          (0.10, zi - 0.026)], 0.95, 0.00042),
        ([(0.12, 0.012), (0.35, 0.004), (0.62, 0.002), (0.95, 0.001)], 0.35, 0.0004),
    ]  # fmt: skip
    curves = [
        (curve(np.array([(-s * length, z) for s, z in points]), 0.0004), gain, width)
        for points, gain, width in named
    ]
    rng = stream(0, "corpus", 0, 0, "palm lines")
    for _ in range(90):
        centre = np.array([-rng.uniform(0.15, 1.0) * length, rng.uniform(zp, zi)])
        angle, reach = rng.normal(0.5 * np.pi, 0.7), rng.uniform(0.005, 0.018)
        half = np.array([np.cos(angle), np.sin(angle)]) * reach
        points = np.stack([centre - half, centre + rng.normal(size=2) * 0.0015, centre + half])
        curves.append((curve(points, 0.0004), float(rng.uniform(0.08, 0.34)), 0.0003))
    return curves


def _wrist_lines(sites: Sites, facing: Values) -> tuple[Values, Values]:
    """Bracelet lines on the palm side of the wrist; faint cross lines on its back."""
    height, tint = np.zeros(len(facing), np.float32), np.zeros(len(facing), np.float32)
    own = np.flatnonzero(np.abs(sites.points[:, 0]) < 0.03)
    points, side = sites.points[own], facing[own]
    for k, (x, gain) in enumerate(((0.000, 0.8), (0.009, 0.45), (-0.008, 0.25))):
        sway = 0.0016 * solid_noise(points, 0.02, f"wrist line/{k}", 2)
        u = points[:, 0] - x - sway - 6 * points[:, 2] ** 2
        broken = np.clip(0.6 + 0.5 * solid_noise(points, 0.012, f"wrist gap/{k}"), 0, 1)
        line = gain * bump(u, sites.width(0.0005)) * broken * np.clip((side - 0.25) / 0.4, 0, 1)
        height[own] -= (0.26 * line).astype(np.float32)
        tint[own] += (0.8 * line).astype(np.float32)
        back = 0.3 * gain * bump(u * 0.6, sites.width(0.0008)) * np.clip((-side - 0.2) / 0.6, 0, 1)
        height[own] -= (0.12 * back).astype(np.float32)
    return height, tint
