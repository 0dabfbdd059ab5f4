"""Training data of the initialiser: posed hands seen by depth cameras, as points and keypoints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.normals import unit, vertex_normals
from synthgen.models import BodyModel
from synthgen.registration.initialiser import POINTS, SCALE_M
from synthgen.registration.prior import training_poses
from synthgen.registration.simulated import cameras_around, view_points
from synthgen.registration.surface import surface_of

Single = NDArray[np.float32]
VIEWS, PER_VIEW, PIXELS = 6, 160, 64


@dataclass(frozen=True, eq=False)
class Bank:
    """Hands (H), each seen from six sides.

    Attributes
    ----------
    points, normals : (H, 6, 160, 3) float16, metres / 60 mm
    keypoints : (H, 21, 3) float32, metres / 60 mm
        16 joints, then five tips.
    """

    points: NDArray[np.float16]
    normals: NDArray[np.float16]
    keypoints: Single

    def batch(self, ids: NDArray[np.int64], *, rng: np.random.Generator) -> tuple[Single, Single]:
        """Return inputs (B, 128, 6) and keypoints (B, 21, 3) in random orientation, centred.

        One to three views, two holes, noise, outliers.
        """
        b = len(ids)
        order = np.argsort(rng.random((b, VIEWS)), axis=1)
        views = np.where(rng.random(b) < 0.3, 1, rng.integers(2, 4, b))
        p = self.points[ids].astype(np.float32)
        n = self.normals[ids].astype(np.float32)
        ok = np.empty((b, VIEWS), dtype=bool)
        np.put_along_axis(ok, order, np.arange(VIEWS) < views[:, None], axis=1)
        keep = np.repeat(ok, PER_VIEW, axis=1)
        p, n = p.reshape(b, -1, 3), n.reshape(b, -1, 3)
        rows = np.arange(b)
        for _ in range(2):
            hole = p[rows, rng.integers(p.shape[1], size=b)]
            radius = rng.uniform(0, 0.009 / SCALE_M, (b, 1))
            keep &= np.linalg.norm(p - hole[:, None], axis=2) > radius
        key = np.where(keep, rng.random(keep.shape), 2.0)
        chosen = np.argsort(key, axis=1)[:, :POINTS]
        fewer = np.minimum(np.maximum(keep.sum(axis=1), 1), POINTS)[:, None]
        chosen = np.take_along_axis(chosen, np.arange(POINTS)[None] % fewer, axis=1)
        p, n = p[rows[:, None], chosen], n[rows[:, None], chosen]
        p += rng.normal(0, 6e-4 / SCALE_M, p.shape)
        wild = rng.random(p.shape[:2]) < 0.008
        p[wild] += rng.normal(0, 0.04 / SCALE_M, (int(wild.sum()), 3))
        facing = unit((n + rng.normal(0, 0.15, n.shape)).astype(np.float64))
        turn = random_rotations(b, rng=rng)
        centre = p.mean(axis=1, keepdims=True)
        inputs = np.concatenate([(p - centre) @ turn.transpose(0, 2, 1),
                                 facing @ turn.transpose(0, 2, 1)], axis=2)  # fmt: skip
        keypoints = (self.keypoints[ids] - centre) @ turn.transpose(0, 2, 1)
        return inputs.astype(np.float32), keypoints.astype(np.float32)


def make_bank(model: BodyModel, hands: int, *, rng: np.random.Generator) -> Bank:
    """Pose, look and sample; about 10 CPU ms a hand."""
    surface = surface_of(model)
    poses = training_poses(model, hands, rng=rng)
    points = np.empty((hands, VIEWS, PER_VIEW, 3), np.float16)
    normals, keypoints = np.empty_like(points), np.empty((hands, 21, 3), np.float32)
    for k, fingers in enumerate(poses):
        shape = np.clip(rng.standard_normal(model.n_shape), -2.5, 2.5)
        pose = np.concatenate([np.zeros(3), fingers]).reshape(-1, 3)
        placed = surface.at(surface.pack(shape, pose, np.zeros(3)))
        smooth = vertex_normals(placed.vertices, surface.faces)
        for v, camera in enumerate(cameras_around(placed.vertices, VIEWS, PIXELS, rng=rng)):
            p, n = view_points(placed.vertices, surface.faces, smooth, camera)
            some = rng.integers(len(p), size=PER_VIEW)
            points[k, v], normals[k, v] = p[some] / SCALE_M, n[some]
        tips = placed.vertices[model.fingertip_ids]
        keypoints[k] = np.concatenate([placed.joints, tips]) / SCALE_M
    return Bank(points, normals, keypoints)


def random_rotations(n: int, *, rng: np.random.Generator) -> NDArray[np.float64]:
    """Uniform rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.random(n, rng=rng).as_matrix())
