"""Where a fit begins: hypotheses for the coarse stage."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.registration.coarse import distinct, energies
from synthgen.registration.coarse_model import COMPONENTS, CoarseModel, Single, Starts, join
from synthgen.registration.initialiser import Initialiser

Array = NDArray[np.float64]
TABLE_ROTATIONS, KEEP, APART_M, SIGMA_M, LOOK = 288, 24, 0.004, 0.020, 100


@lru_cache(maxsize=4)
def spread_rotations(n: int) -> Single:
    """Return n rotations (n, 3, 3) spread over SO(3), the same ones every time.

    The super-Fibonacci spiral of quaternions (Alexa 2022).
    """
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(n) + 0.5
    r, R = np.sqrt(s / n), np.sqrt(1 - s / n)
    a, b = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    from scipy.spatial.transform import Rotation

    q = np.stack([r * np.sin(a), r * np.cos(a), R * np.sin(b), R * np.cos(b)], axis=1)
    return Rotation.from_quat(q).as_matrix().astype(np.float32)


def learned_starts(
    net: Initialiser, model: CoarseModel, points: Single, normals: Single, turns: int
) -> Starts:
    """Hypotheses of the network, the scan seen under ``turns`` rotations."""
    return net.starts(points, normals, spread_rotations(turns), model.n_shape)


def table_starts(model: CoarseModel, points: Single, normals: Single, centre: Array) -> Starts:
    """Weight-free hypotheses: typical poses under 288 rotations, the best by energy."""
    best = []
    for pose in model.prior.table:
        starts = _turned(model, pose[None], spread_rotations(TABLE_ROTATIONS), centre)
        best.append(ranked(model, starts, points, normals, 4))
    return join(best)


def around(model: CoarseModel, x: Array, centre: Array) -> Starts:
    """Hypotheses at a known rotation: the vector x itself, the mean and typical poses."""
    given = model.from_vectors(x[None])
    poses = np.concatenate([model.prior.mean[None], model.prior.table])
    rotation = matrix_from_axis_angle(x[model.surface.root]).astype(np.float32)
    return join([given, _turned(model, poses, rotation[None], centre)])


def _turned(model: CoarseModel, poses: Array, rotations: Single, centre: Array) -> Starts:
    """Every pose under every rotation, centred."""
    prior = model.prior
    offset = (poses - prior.mean) @ prior.components[:COMPONENTS].T / prior.sd[:COMPONENTS]
    z = np.clip(offset, -3, 3).astype(np.float32)
    n = len(poses) * len(rotations)
    starts = Starts(
        np.tile(rotations, (len(poses), 1, 1)),
        np.zeros((n, 3), np.float32),
        np.repeat(z, len(rotations), axis=0),
        np.zeros((n, model.n_shape), np.float32),
    )
    middle = model.place(starts).vertices.mean(axis=1)
    moved = (np.asarray(centre) - middle).astype(np.float32)
    return Starts(starts.rotation, moved, starts.coefficients, starts.shape)


def ranked(
    model: CoarseModel, starts: Starts, points: Single, normals: Single, keep: int = KEEP
) -> Starts:
    """Return the best distinct hypotheses by energy at 20 mm."""
    energy, placed = energies(model, starts, points[:LOOK], normals[:LOOK], SIGMA_M)
    return starts.take(distinct(placed.vertices, energy, keep, APART_M))


def reseeded(model: CoarseModel, x: Array, fingers: Array) -> Starts:
    """Return the fitted hand with every finger in turn replaced by each of its typical poses."""
    first = model.surface.fingers.start
    variants = np.repeat(x[None], fingers.shape[0] * fingers.shape[1], axis=0)
    for k, row in enumerate(variants):
        f, p = divmod(k, fingers.shape[1])
        row[first + 9 * f : first + 9 * f + 9] = fingers[f, p]
    return model.from_vectors(variants)
