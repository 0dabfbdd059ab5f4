"""Meshes of what is worn: sleeves, bracelets, watches and rings, fitted to the posed subject.

Everything is built around the rest pose, where arm and fingers are straight, from harmonics fitted
to the skin's cross-section, and carried along by the bones that carry the skin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from synthgen.geometry.normals import unit
from synthgen.models import ManoModel
from synthgen.models.joints import MANO16_PARENTS
from synthgen.models.surface import ArmBones, arm_bones
from synthgen.scene.description import Band, HandSubject, Sleeve, Thing
from synthgen.scene.solids import (
    TURNED_TRIANGLES,
    TURNED_VERTICES,
    SolidMesh,
    grid_triangles,
    mesh_of,
)

Array = NDArray[np.float64]

AROUND, RINGS = 64, 72
# A sleeve begins inside itself, so that its opening shows a hem and not the end of a surface.
_HEM_M, _CLOTH_M = 0.03, 0.0025
_BAND_AROUND, _SECTION = 44, 10
_WINDOW_M = 0.012
BAND_VERTICES = (_BAND_AROUND + 1) * (_SECTION + 1) + TURNED_VERTICES
SLEEVE_VERTICES = (RINGS + 2) * (AROUND + 1)
_TUBE = grid_triangles(_BAND_AROUND + 1, _SECTION + 1)
BAND_TRIANGLES = np.concatenate([_TUBE, TURNED_TRIANGLES + BAND_VERTICES - TURNED_VERTICES])
SLEEVE_TRIANGLES = grid_triangles(RINGS + 2, AROUND + 1)


@dataclass(frozen=True, eq=False)
class Dressed:
    """What a subject wears, world, metres: the sleeve or None, and its bands in order."""

    sleeve: SolidMesh | None
    bands: tuple[SolidMesh, ...]


def dress(model: ManoModel, subject: HandSubject) -> Dressed:
    """Return the meshes of what a subject wears."""
    if subject.sleeve is None and not subject.bands:
        return Dressed(None, ())
    body = _body(model, subject)
    sleeve = None if subject.sleeve is None else _sleeve(body, subject.sleeve)
    return Dressed(sleeve, tuple(_band(body, band) for band in subject.bands))


@dataclass(frozen=True, eq=False)
class _Body:
    """Rest-pose skin of one shape, and what carries it into the pose."""

    model: ManoModel
    skin: Array
    joints: Array
    bones: ArmBones
    transforms: Array

    def carried(self, points: Array) -> Array:
        """Carry points beside the arm (n, 3) along with it."""
        arm = self.model.surface.arm
        along, rows = self.bones.along(self.bones.points), arm.weights
        order = np.argsort(along)
        at = self.bones.along(points)
        weights = np.stack(
            [np.interp(at, along[order], ndimage.uniform_filter1d(rows[order, k], 15))
             for k in range(3)], axis=1,
        )  # fmt: skip
        return self.bones.carry(points, weights / weights.sum(axis=1, keepdims=True))


def _body(model: ManoModel, subject: HandSubject) -> _Body:
    betas = np.array(subject.shape)
    posed = model.evaluate(
        betas[None], np.array(subject.pose)[None], np.array(subject.translation_m)[None]
    )
    bones = arm_bones(model, betas, posed, np.array(subject.wrist), np.array(subject.elbow))
    vertices, joints = model.shaped(betas)
    return _Body(
        model, np.concatenate([vertices, bones.points]), joints, bones, posed.transforms[0]
    )


def _across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors across an axis, the first towards the back of the hand (+y at rest)."""
    back = np.array([0.0, 1.0, 0.0])
    first = unit(back - (back @ axis) * axis)
    return first, np.cross(axis, first)


def _radii(points: Array, root: Array, axis: Array, stations: Array, angles: Array) -> Array:
    """Fit the skin's radius (stations, angles) about an axis with two harmonics.

    The ridge keeps a thin sample of vertices from flaring into a funnel.
    """
    first, second = _across(axis)
    offset = points - root
    u, x, y = offset @ axis, offset @ first, offset @ second
    angle, radius = np.arctan2(y, x), np.hypot(x, y)
    basis = _harmonics(angle)
    wanted = _harmonics(angles)
    rows = []
    for station in np.clip(stations, u.min() + 0.005, u.max() - 0.005):
        weight = np.exp(-(((u - station) / _WINDOW_M) ** 2))
        mean = float(weight @ radius / weight.sum())
        normal = basis.T @ (basis * weight[:, None])
        normal += np.diag([1e-9, 1, 1, 1, 1]) * 0.05 * weight.sum()
        rows.append(mean + wanted @ np.linalg.solve(normal, basis.T @ (weight * (radius - mean))))
    return np.array(rows)


def _harmonics(angle: Array) -> Array:
    one = np.ones_like(angle)
    return np.stack(
        [one, np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=-1
    )


def _sleeve(body: _Body, sleeve: Sleeve) -> SolidMesh:
    axis, root = body.bones.axis, body.bones.root
    end = float(body.bones.along(body.bones.points).max())
    stations = np.linspace(sleeve.start_m, end + 0.01, RINGS)
    angles = 2 * np.pi * np.arange(AROUND + 1) / AROUND
    radius = _radii(body.skin, root, axis, stations, angles) + sleeve.slack_m
    radius += _folds(sleeve, stations, angles)
    hem = radius[:1] - _CLOTH_M
    radius = np.concatenate([hem, hem, radius])
    stations = np.concatenate([[sleeve.start_m + _HEM_M, sleeve.start_m], stations])
    first, second = _across(axis)
    around = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    rest = root + stations[:, None, None] * axis + radius[..., None] * around
    grid = body.carried(rest.reshape(-1, 3)).reshape(rest.shape)
    v, u = np.meshgrid((stations - stations[2]) / 0.3, angles / (2 * np.pi), indexing="ij")
    normals = _grid_normals(grid, (False, True))
    return SolidMesh(
        vertices=grid.reshape(-1, 3),
        triangles=SLEEVE_TRIANGLES,
        normals=normals.reshape(-1, 3),
        uv=np.stack([u.ravel(), v.ravel()], axis=1),
    )


def _folds(sleeve: Sleeve, stations: Array, angles: Array) -> Array:
    """Rings of cloth, bent by noise; none at the cuff."""
    rng = np.random.Generator(np.random.Philox(sleeve.seed))
    noise = rng.standard_normal((len(stations), len(angles) - 1))
    noise = ndimage.gaussian_filter(noise, (1.6, 5.0), mode=("nearest", "wrap"))
    noise = np.concatenate([noise, noise[:, :1]], axis=1) / noise.std()
    pitch = rng.uniform(0.012, 0.03)
    waves = np.sin(2 * np.pi * stations[:, None] / pitch + 1.8 * noise) + 0.7 * noise
    cuff = np.clip((stations - stations[0]) / 0.02, 0, 1)[:, None] ** 2
    return np.asarray(sleeve.fold_m * cuff * np.maximum(waves, -1.2))


def _band(body: _Body, band: Band) -> SolidMesh:
    if band.kind == "ring":
        joint, child = band.finger, MANO16_PARENTS.index(band.finger)
        root, tip = body.joints[joint], body.joints[child]
        axis = unit(tip - root)
        station = band.place * float(np.linalg.norm(tip - root))
        hand = body.skin[: len(body.model.weights)]
        skin = hand[body.model.weights[:, joint] > 0.4]
        frame = body.transforms[joint]

        def carry(points: Array) -> Array:
            return np.asarray((points - root) @ frame[:3, :3].T + frame[:3, 3])
    else:
        root, axis, station = body.bones.root, body.bones.axis, band.place
        skin, carry = body.skin, body.carried
    angles = 2 * np.pi * np.arange(_BAND_AROUND + 1) / _BAND_AROUND
    radius = _radii(skin, root, axis, np.array([station]), angles)[0] + 0.0004
    first, second = _across(axis)
    around = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    turn = 2 * np.pi * np.arange(_SECTION + 1) / _SECTION
    along = 0.5 * band.width_m * _squarish(np.sin(turn))
    out = 0.5 * band.thickness_m * (1 + _squarish(np.cos(turn)))
    rest = (
        root
        + (station + along)[None, :, None] * axis
        + (radius[:, None] + out)[..., None] * around[:, None]
    )
    grid = carry(rest.reshape(-1, 3)).reshape(rest.shape)
    tube = _grid_normals(grid, (True, True)).reshape(-1, 3)
    case = _case(root + station * axis + radius[0] * first, first, band)
    dial = carry(case.vertices)
    turned = dial - carry(case.vertices - 1e-3 * case.normals)
    v, u = np.meshgrid(angles / (2 * np.pi), turn / (2 * np.pi), indexing="ij")
    return SolidMesh(
        vertices=np.concatenate([grid.reshape(-1, 3), dial]),
        triangles=BAND_TRIANGLES,
        normals=np.concatenate([tube, unit(turned)]),
        uv=np.concatenate([0.5 * np.stack([u.ravel(), v.ravel()], axis=1), 0.5 + 0.5 * case.uv]),
    )


def _squarish(x: Array) -> Array:
    return np.asarray(np.sign(x) * np.abs(x) ** 0.6)


def _case(place: Array, up: Array, band: Band) -> SolidMesh:
    """Make a watch's case on the back of the wrist; a speck inside the band of others."""
    size = (0.038, 0.0095, 0.038) if band.kind == "watch" else (1e-4, 1e-4, 1e-4)
    depth = band.thickness_m + size[1] / 2 - 0.002
    tilt = np.cross([0.0, 1.0, 0.0], up)
    position = place + up * (depth if band.kind == "watch" else band.thickness_m / 2)
    return mesh_of(
        Thing("furniture", "cylinder", _vec(position), _vec(tilt), size, band.colour_rgb,
              band.colour_rgb, 0.3, 0)
    )  # fmt: skip


def _vec(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def _grid_normals(grid: Array, closed: tuple[bool, bool]) -> Array:
    """Return unit normals of a grid (n, m, 3) whose closed directions repeat their first line."""
    down, across = (_slope(grid, axis, closed[axis]) for axis in (0, 1))
    return unit(np.cross(across, down))


def _slope(grid: Array, axis: int, closed: bool) -> Array:
    if not closed:
        return np.asarray(np.gradient(grid, axis=axis))
    moved = np.moveaxis(grid, axis, 0)[:-1]
    slope = np.roll(moved, -1, axis=0) - np.roll(moved, 1, axis=0)
    return np.moveaxis(np.concatenate([slope, slope[:1]]), 0, axis)
