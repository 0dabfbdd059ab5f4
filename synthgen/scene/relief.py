"""Shape that a low-resolution hand lacks: tendons, knuckles, wrist bones, webs, veins.

Heights along the normal of the drawn surface, laid out on the rest pose and weighted by the pose:
tendons stand out where fingers are stretched, knuckles where they are bent. They are bounded by
``Skin.relief_m``, which is part of every sample's record; 0 leaves the model's surface as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import unit
from synthgen.models import ManoModel
from synthgen.scene.anatomy import Anatomy, anatomy_of, flexion_rad
from synthgen.scene.description import Skin
from synthgen.scene.veins import vein_field

Array = NDArray[np.float64]

# Heights below are millimetres at this bound; smaller bounds scale them.
REFERENCE_M = 0.002
# Neighbouring fingers, by row of ``Anatomy.fingers``: index, middle, pinky, ring, thumb.
_NEIGHBOURS = ((0, 1), (1, 3), (3, 2))


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights per refined vertex, millimetres.

    Attributes
    ----------
    still : (n,)
        Whatever the pose.
    veins : (n,)
        At gain 1.
    tendons, knuckles : (5, n)
        Per finger, fully stretched, and fully bent.
    """

    still: Array
    veins: Array
    tendons: Array
    knuckles: Array


def relief_of(model: ManoModel, skin: Skin, pose: NDArray[Any]) -> Array | None:
    """Return the height of every refined vertex over the smooth surface.

    Parameters
    ----------
    model : ManoModel
    skin : Skin
        ``relief_m`` bounds the result; ``veins`` is the gain of the veins.
    pose : (K, 3) float
        As the subject's.

    Returns
    -------
    (n,) float64 or None
        Metres, absolute values below ``relief_m``; None where that is 0.
    """
    if skin.relief_m == 0:
        return None
    relief, bent = _layout(model), flexion_rad(model, pose)
    first = bent[[f.joints[int(f.is_thumb)] for f in anatomy_of(model).fingers]]
    stretched = np.clip(0.30 - 1.1 * (first - 0.15), 0.0, 1.0)
    folded = 0.35 + 0.65 * np.clip(first / 1.2, 0.0, 1.0)
    height = relief.still + skin.veins * relief.veins
    height = height + stretched @ relief.tendons + folded @ relief.knuckles
    # A soft bound: small heights pass, none reaches relief_m.
    return np.asarray(skin.relief_m * np.tanh(height * 1e-3 / REFERENCE_M))


@lru_cache(maxsize=8)
def _layout(model: ManoModel) -> Relief:
    a = anatomy_of(model)
    fingers = range(len(a.fingers))
    return Relief(
        still=sum((_profile(a, f) for f in fingers), _wrist(a) + _webs(a)),
        veins=0.55 * vein_field(a.points, a.normals, a.weights, a),
        tendons=np.stack([_tendon(a, f) for f in fingers]),
        knuckles=np.stack([_knuckle(a, f) for f in fingers]),
    )


def bump(distance: Any, radius: Any) -> Array:
    """Return a Gaussian bump of height 1."""
    return np.asarray(np.exp(-((np.asarray(distance) / radius) ** 2)))


def segment_distance(points: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Distances (n,) of points from a segment, and where along it (0..1) the nearest points are."""
    line = end - start
    t = np.clip((points - start) @ line / max(float(line @ line), 1e-12), 0, 1)
    return np.linalg.norm(points - start - t[:, None] * line, axis=1), t


def _profile(a: Anatomy, number: int) -> Array:
    """Thicker at the joints, slimmer between them; soft pads on the palm side."""
    finger, height = a.fingers[number], np.zeros(len(a.points))
    own = np.clip(2 * a.finger_weight(number) - 0.6, 0, 1)
    bones = np.diff(finger.points, axis=0)
    for k in (1, 2):
        u = (a.points - finger.points[k]) @ unit(bones[k - 1] + bones[k])
        side = a.normals @ finger.back
        joint, gain = bump(u, 0.0060), (0.40, 0.25)[k - 1]
        height += gain * joint * np.clip(0.75 + 0.6 * side, 0, 1) * own
        height -= 0.55 * joint * np.clip(-side, 0, 1) * own
    for k in (0, 1):
        start = 1 if finger.is_thumb and k == 0 else k
        u = (a.points - (finger.points[start] + 0.55 * bones[start])) @ unit(bones[start])
        side = a.normals @ finger.back
        height += 0.35 * bump(u, 0.007) * np.clip(-side, 0, 1) * own
        height -= (
            0.25 * bump(u, 0.006) * np.clip(1 - np.abs(side) * 0.6, 0, 1) * own * (side > -0.5)
        )
    return height


def _knuckle(a: Anatomy, number: int) -> Array:
    """Head of the metacarpal, with the dip on either side of it."""
    finger = a.fingers[number]
    joint = finger.points[1] if finger.is_thumb else finger.points[0]
    top = _skin_over(a, joint, finger.back)
    away = a.points - top
    dorsal = np.clip(a.normals @ finger.back * 1.6, 0, 1)
    ridge = bump(np.linalg.norm(away * [1.0, 1.0, 1.25], axis=1), 0.0075)
    return np.asarray(1.25 * ridge * dorsal)


def _tendon(a: Anatomy, number: int) -> Array:
    """Extensor tendon from the knuckle to the wrist, fading at both ends."""
    finger = a.fingers[number]
    joint = finger.points[1] if finger.is_thumb else finger.points[0]
    start = _skin_over(a, joint, finger.back)
    radial = 0.010 if finger.is_thumb else 0.25 * joint[2] + 0.002
    end = _skin_over(a, np.array([0.004, 0.0, radial]), np.array([0.0, 1.0, 0.0]))
    flat = np.array([1.0, 0.25, 1.0])  # the cord follows the skin, not the chord
    distance, t = segment_distance(a.points * flat, start * flat, end * flat)
    dorsal = np.clip((a.normals @ finger.back - 0.25) * 3, 0, 1)
    fade = np.clip(t / 0.12, 0, 1) * np.clip((1 - t) / 0.45, 0, 1)
    cord = bump(distance, 0.0021) - 0.35 * bump(distance, 0.0055)
    return np.asarray((0.95 if not finger.is_thumb else 1.2) * cord * dorsal * fade)


def _wrist(a: Anatomy) -> Array:
    """Head of the ulna and styloid of the radius; a hollow on the thumb's side before it."""
    height = np.zeros(len(a.points))
    for place, direction, radius, gain in (
        ((0.020, 0.0, 0.0), (0.0, 0.75, -0.66), 0.0095, 1.8),
        ((0.012, 0.0, 0.0), (0.0, 0.25, 0.97), 0.0090, 0.8),
        ((-0.012, 0.0, 0.0), (0.0, 0.55, 0.83), 0.0075, -0.8),
    ):
        top = _skin_over(a, np.array(place), np.array(direction))
        height += gain * bump(np.linalg.norm(a.points - top, axis=1), radius)
    return height


def _webs(a: Anatomy) -> Array:
    """Skin between the bases of neighbouring fingers, pushed out towards the fingertips."""
    height = np.zeros(len(a.points))
    for left, right in _NEIGHBOURS:
        p, q = a.fingers[left].points, a.fingers[right].points
        distal = unit(unit(p[1] - p[0]) + unit(q[1] - q[0]))
        where = (p[0] + q[0]) / 2 + 0.42 * distal * (_length(p) + _length(q)) / 2
        facing = np.clip(a.normals @ distal * 1.5 - 0.15, 0, 1)
        height += 1.7 * facing * bump(np.linalg.norm(a.points - where, axis=1), 0.011)
    return height


def _length(points: Array) -> float:
    return float(np.linalg.norm(points[1] - points[0]))


def _skin_over(a: Anatomy, place: Array, direction: Array) -> Array:
    """Vertex that lies straight out from a place within the hand, in a direction."""
    out = unit(direction)
    offset = a.points - place
    along = offset @ out
    aside = np.linalg.norm(offset - along[:, None] * out, axis=1)
    return np.asarray(a.points[np.argmax(np.where(along > 0, -aside + 0.05 * along, -np.inf))])
