"""Noisy partial scans of whole bodies from a z-buffer, as a stage of 22 scanner units takes them.

Occlusion, grazing angles, noise along the normal, and what befalls hands, which are 2-3 % of the
points each: smoothed, noisier, fingers grown together, parts lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthgen.errors import ShapeError
from synthgen.geometry.cameras import Camera, camera_from_K
from synthgen.geometry.normals import face_cross, incidence, unit
from synthgen.geometry.raster import rasterise
from synthgen.geometry.transforms import look_at
from synthgen.models import BodyModel
from synthgen.models.hand_pca import finger_joints
from synthgen.models.joints import SIDES
from synthgen.sampling.body_pose import hands_of

Array = NDArray[np.float64]
# Heights of the units: count, elevation (degrees), share of a step by which the ring is turned.
_RINGS = ((8, 5, 0.0), (7, 40, 0.2), (6, -25, 0.4), (1, 80, 0.0))
DISTANCE_M, PIXEL_M = 4.0, 3e-3
GRAZING_COSINE, BEHIND_M = 0.3, 2e-3
TANGENTIAL, SMOOTHED = 0.3, 0.6
# Hands are smoothed over so many neighbours: at 150,000 points, a radius of 7 mm.
NEIGHBOURS_PER_POINT, LEAST_NEIGHBOURS = 24 / 150_000, 4
WEB_REACH_M, WEB_SHARE, WEB_NORMAL = 0.012, 0.12, 0.5
MARGIN_M = 0.08
NO_HAND, WEB, WILD = -1, 2, -2


@dataclass(frozen=True)
class BodyScanSettings:
    """How a body's scan is taken.

    Attributes
    ----------
    points : int
        Points kept at most, webbing and outliers not counted.
    noise_m : float
        Standard deviation along the normal, metres; 0.3 of it in each direction besides.
    normal_noise, hand_normal_noise : float
        Standard deviations added to each coordinate of the unit normals.
    hand_noise_m : float
        Noise on top along the normals of hands, which are smoothed first.
    outliers : float
        Share of points scattered in the scan's box.
    webbing : bool
        Points between fingers that are closer than 12 mm, an eighth of a hand's.
    lost : mapping of "left" or "right" to a share
        Of each hand, 0..1: a connected region, or at 1 the whole hand.
    """

    points: int = 150_000
    noise_m: float = 7.5e-4
    normal_noise: float = 0.15
    hand_normal_noise: float = 0.25
    hand_noise_m: float = 1e-3
    outliers: float = 0.01
    webbing: bool = True
    lost: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class BodyScan:
    """A scan in random order.

    Attributes
    ----------
    points, normals : (N, 3) float64
        World, metres; outward.
    side : (N,) int8
        0 left hand, 1 right hand, -1 the rest of the body, 2 webbing, -2 an outlier.
    coverage : float
        Share of the skin's area that some unit sees.
    """

    points: Array
    normals: Array
    side: NDArray[np.int8]
    coverage: float


def simulate_body_scan(
    model: BodyModel,
    vertices: NDArray[Any],
    settings: BodyScanSettings,
    *,
    rng: np.random.Generator,
) -> BodyScan:
    """Scan a posed body.

    Parameters
    ----------
    model : BodyModel
        Whose faces and hands the mesh has; without fingers there are no hands to spoil.
    vertices : (V, 3) float
        World, metres, y up.
    settings : BodyScanSettings
    rng : numpy.random.Generator

    Raises
    ------
    ShapeError
        If ``lost`` names no side or a share is not 0..1.
    """
    for side, share in settings.lost.items():
        if side not in SIDES or not 0 <= share <= 1:
            raise ShapeError(f"lost={{{side!r}: {share}}}; expected 'left' or 'right': 0..1")
    mesh = np.ascontiguousarray(vertices, dtype=np.float64)
    hand, finger = _hands(model)
    faces = np.ascontiguousarray(model.faces, dtype=np.int64)
    face, points, normals, flat = _surface_points(mesh, faces, int(1.35 * settings.points), rng)
    seen = _seen_by_any(mesh, faces, points, flat)
    coverage = float(seen.mean())
    own = hand[faces[face, 0]]
    for k, side in enumerate(SIDES):
        _lose(seen, points, own == k, settings.lost.get(side, 0.0), rng)
    kept = np.flatnonzero(seen)[: settings.points]
    p, n, own = points[kept], normals[kept], own[kept]
    part = finger[faces[face[kept], 0]]
    sharp = n.copy()
    p = p + n * rng.normal(0, settings.noise_m, (len(p), 1))
    p += rng.normal(0, TANGENTIAL * settings.noise_m, p.shape)
    n = n + rng.normal(0, settings.normal_noise, n.shape)
    webs = [_spoil(p, n, sharp, np.flatnonzero(own == k), part, settings, rng) for k in (0, 1)]
    p, n, own = _joined(p, n, own, [w for w in webs if w is not None], settings.outliers, rng)
    order = rng.permutation(len(p))
    return BodyScan(p[order], unit(n[order]), own[order], coverage)


@lru_cache(maxsize=8)
def _hands(model: BodyModel) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Return each vertex's hand (0 left, 1 right, -1 none) and finger (0-4, -1 palm or none)."""
    strongest = model.weights.argmax(axis=1)
    hand = np.full(len(strongest), NO_HAND, dtype=np.int8)
    finger = np.full(len(strongest), -1, dtype=np.int8)
    for side in hands_of(model):
        k, joints = SIDES.index(side), finger_joints(model, side)
        hand[np.isin(strongest, [*joints, model.joint_names.index(f"{side}_wrist")])] = k
        for place, joint in enumerate(joints):
            finger[strongest == joint] = place // 3
    return hand, finger


def _surface_points(
    mesh: Array, faces: NDArray[np.int64], n: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Draw points evenly over the skin, shuffled: face, point, smooth normal, face normal."""
    cross = face_cross(mesh, faces)
    smooth = unit(incidence(faces, len(mesh)) @ cross)
    area = np.cumsum(np.linalg.norm(cross, axis=1))
    at = (rng.permutation(n) + rng.random(n)) / n * area[-1]
    face = np.minimum(np.searchsorted(area, at), len(faces) - 1)
    root, along = np.sqrt(rng.random(n)), rng.random(n)
    b = np.stack([1 - root, root * (1 - along), root * along], axis=1)
    points, normals = np.empty((n, 3)), np.empty((n, 3))
    _blend(mesh, smooth, faces, face, b, points, normals)
    return face, points, normals, unit(cross[face])


def units_around(mesh: Array) -> list[Camera]:
    """Return the 22 cameras of the stage, each with the whole body in its picture."""
    low, high = mesh.min(axis=0), mesh.max(axis=0)
    centre = (low + high) / 2
    radius = float(np.linalg.norm(mesh - centre, axis=1).max())
    distance = max(DISTANCE_M, 2.5 * radius)
    focal = distance / PIXEL_M
    pixels = int(2.1 * focal * radius / np.sqrt(distance**2 - radius**2)) + 2
    middle = pixels / 2 - 0.5
    K = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    cameras = []
    for count, elevation, offset in _RINGS:
        for k in range(count):
            yaw, rise = 2 * np.pi * (k + offset) / count, np.deg2rad(elevation)
            towards = np.array(
                [np.sin(yaw) * np.cos(rise), np.sin(rise), np.cos(yaw) * np.cos(rise)]
            )
            pose = look_at(centre + distance * towards, centre)
            cameras.append(camera_from_K(K, pixels, pixels, pose))
    return cameras


def _seen_by_any(
    mesh: Array, faces: NDArray[np.int64], points: Array, normals: Array
) -> NDArray[np.bool_]:
    """Return (n,) whether some unit sees a point, not grazing."""
    seen = np.zeros(len(points), dtype=np.bool_)
    for camera in units_around(mesh):
        depth = rasterise(mesh, faces, camera)[2]
        _mark_seen(points, normals, camera.T, camera.K, depth, seen)
    return seen


def _lose(
    seen: NDArray[np.bool_],
    points: Array,
    hand: NDArray[np.bool_],
    share: float,
    rng: np.random.Generator,
) -> None:
    """Forget the points of a hand around a random one of them."""
    ids = np.flatnonzero(hand & seen)
    if share <= 0 or len(ids) == 0:
        return
    distance = np.linalg.norm(points[ids] - points[rng.choice(ids)], axis=1)
    lost = ids if share >= 1 else ids[distance < np.quantile(distance, share)]
    seen[lost] = False


def _spoil(
    p: Array,
    n: Array,
    sharp: Array,
    ids: NDArray[np.int64],
    finger: NDArray[np.int8],
    settings: BodyScanSettings,
    rng: np.random.Generator,
) -> tuple[Array, Array] | None:
    """Smooth and roughen one hand's points in place; return its webbing, or None."""
    k = max(LEAST_NEIGHBOURS, round(NEIGHBOURS_PER_POINT * settings.points))
    if len(ids) <= k:
        return None
    tree = cKDTree(p[ids])
    near = ids[np.asarray(tree.query(p[ids], k=k)[1])]
    extra = np.sqrt(max(settings.hand_normal_noise**2 - settings.normal_noise**2, 0.0))
    pairs = ids[tree.query_pairs(WEB_REACH_M, output_type="ndarray")]
    count = int(WEB_SHARE * len(ids)) if settings.webbing else 0
    web = _webbing(p, sharp, pairs, finger, count, rng)
    smooth = (1 - SMOOTHED) * p[ids] + SMOOTHED * p[near].mean(axis=1)
    p[ids] = smooth + sharp[ids] * rng.normal(0, settings.hand_noise_m, (len(ids), 1))
    n[ids] += rng.normal(0, extra, (len(ids), 3))
    return web


def _webbing(
    p: Array,
    normals: Array,
    pairs: NDArray[np.int64],
    finger: NDArray[np.int8],
    count: int,
    rng: np.random.Generator,
) -> tuple[Array, Array] | None:
    """Put points between close fingers, as stereo matching does."""
    first, second = finger[pairs].T
    pairs = pairs[(first != second) & (first >= 0) & (second >= 0)]
    if len(pairs) == 0 or count == 0:
        return None
    a, b = pairs[rng.integers(len(pairs), size=min(len(pairs), count))].T
    share = rng.random((len(a), 1))
    points = p[a] * share + p[b] * (1 - share)
    return points, normals[a] + rng.normal(0, WEB_NORMAL, points.shape)


def _joined(
    p: Array,
    n: Array,
    own: NDArray[np.int8],
    webs: list[tuple[Array, Array]],
    outliers: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, NDArray[np.int8]]:
    """Add the webbing and outliers in the scan's box."""
    count = int(outliers * len(p))
    low, high = p.min(axis=0) - MARGIN_M, p.max(axis=0) + MARGIN_M
    wild = rng.uniform(low, high, (count, 3))
    more = sum(len(w[0]) for w in webs)
    side = np.concatenate([own, np.full(more, WEB), np.full(count, WILD)]).astype(np.int8)
    return (np.concatenate([p, *(w[0] for w in webs), wild]),
            np.concatenate([n, *(w[1] for w in webs), rng.standard_normal((count, 3))]),
            side)  # fmt: skip


@njit(cache=True, error_model="numpy")
def _blend(
    mesh: Any, smooth: Any, faces: Any, face: Any, b: Any, points: Any, normals: Any
) -> None:
    for i in range(len(face)):
        length = 0.0
        for a in range(3):
            p, n = 0.0, 0.0
            for k in range(3):
                v = faces[face[i], k]
                p += b[i, k] * mesh[v, a]
                n += b[i, k] * smooth[v, a]
            points[i, a], normals[i, a] = p, n
            length += n * n
        for a in range(3):
            normals[i, a] /= max(np.sqrt(length), 1e-12)


@njit(cache=True, error_model="numpy")
def _mark_seen(points: Any, normals: Any, T: Any, K: Any, depth: Any, seen: Any) -> None:
    """Mark points that a camera sees; a pixel's depth varies with the slope of the skin."""
    height, width = depth.shape
    local = np.empty(3)
    for i in range(len(points)):
        if seen[i]:
            continue
        cosine, length = 0.0, 0.0
        for a in range(3):
            offset = T[a, 3] - points[i, a]
            cosine += offset * normals[i, a]
            length += offset * offset
        cosine /= np.sqrt(length)
        if cosine <= GRAZING_COSINE:
            continue
        for a in range(3):
            local[a] = 0.0
            for k in range(3):
                local[a] += (points[i, k] - T[k, 3]) * T[k, a]
        x = int(np.rint(K[0, 0] * local[0] / local[2] + K[0, 2]))
        y = int(np.rint(K[1, 1] * local[1] / local[2] + K[1, 2]))
        if x < 0 or y < 0 or x >= width or y >= height:
            continue
        slope = np.sqrt(max(1 - cosine * cosine, 0.0)) / cosine
        front = depth[y, x]
        seen[i] = front == 0.0 or local[2] < front + PIXEL_M * slope + BEHIND_M
