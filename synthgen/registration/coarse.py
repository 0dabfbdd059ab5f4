"""Batched coarse registration: Gauss-Newton on all starts at once, with fixed damping.

One distance matrix per start, in position and normal, gives scan-to-mesh pairs along one axis and
mesh-to-scan pairs along the other. Pairs are summed per vertex before the derivatives come in:
H = J^T A J with one 3 x 3 block A per vertex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from synthgen.geometry.rotations import matrix_from_axis_angle
from synthgen.registration.coarse_model import (
    COMPONENTS,
    CoarseModel,
    PlacedBatch,
    Single,
    Starts,
)

NORMAL_M = 0.020  # a turn of the normal by one radian costs as much as this distance
TANGENTIAL, MESH_TO_SCAN, MESH_TANGENTIAL = 0.3, 0.3, 0.1
PRIOR, DAMPING = 0.002, 0.02
MAX_TURN_RAD, MAX_SD, CLIP_SD, CLIP_SHAPE = 0.6, 1.5, 5.0, 2.5


@dataclass(frozen=True)
class Round:
    """Some steps on the best ``starts``: scan points used, steps, scale; rigid plus size or all."""

    starts: int
    points: int
    steps: int
    sigma_m: float
    rigid: bool = False


COLD = (
    Round(24, 150, 3, 0.025, rigid=True),
    Round(16, 200, 4, 0.020),
    Round(8, 300, 5, 0.012),
    Round(6, 400, 4, 0.008),
)
RESEED = (Round(40, 250, 4, 0.010), Round(6, 400, 4, 0.007))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Scan-to-mesh (S, N): vertex, offset, weight; mesh-to-scan (S, V): normal, offset, weight."""

    vertex: NDArray[np.int64]
    offset: Single
    weight: Single
    scan_normal: Single
    mesh_offset: Single
    mesh_weight: Single
    energy: Single


def energies(
    model: CoarseModel, starts: Starts, points: Single, normals: Single, sigma_m: float
) -> tuple[Single, PlacedBatch]:
    """Return the robust energy (S,) of every start, and its placement."""
    placed = model.place(starts)
    return _pair(model, starts, placed, points, normals, sigma_m).energy, placed


def pairs_of(
    vertices: Single, vertex_normals: Single, points: Single, normals: Single
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Nearest vertex (S, N) of every point and nearest point (S, V) of every vertex.

    Near in position and normal: of starts' vertices (S, V, 3) and points (N, 3).
    """
    own = np.concatenate([vertices, np.float32(NORMAL_M) * vertex_normals], axis=-1)
    scan = np.concatenate([points, np.float32(NORMAL_M) * normals], axis=-1)
    vertex = np.empty((len(vertices), len(points)), np.int64)
    point = np.empty(vertices.shape[:2], np.int64)
    _nearest_both_ways(np.ascontiguousarray(own.transpose(0, 2, 1)), scan, vertex, point)
    return vertex, point


def _pair(
    model: CoarseModel,
    starts: Starts,
    placed: PlacedBatch,
    points: Single,
    normals: Single,
    sigma_m: float,
) -> _Pairs:
    s2 = np.float32(sigma_m**2)
    vertex, point = pairs_of(placed.vertices, placed.normals, points, normals)
    row = np.arange(len(starts))[:, None]
    n = placed.normals[row, vertex]
    offset = placed.vertices[row, vertex] - points
    squared = np.sum(offset * offset, axis=-1)
    plane = (np.sum(offset * n, axis=-1) ** 2 + 0.1 * squared) / np.float32(1.1)
    kept = (np.sum(n * normals, axis=-1) > 0) & ~model.rim[vertex]
    weight = np.where(kept, (s2 / (s2 + plane)) ** 2, 0) / (len(points) * s2)
    energy = np.where(kept, plane / (s2 + plane), 1).mean(axis=1)
    scan_normal, mesh_offset = normals[point], placed.vertices - points[point]
    mesh_squared = np.sum(mesh_offset * mesh_offset, axis=-1)
    mesh_plane = np.sum(mesh_offset * scan_normal, axis=-1) ** 2 + 0.1 * mesh_squared
    hole = np.float32((4 * sigma_m + 0.012) ** 2)
    seen = (np.sum(placed.normals * scan_normal, axis=-1) > 0.3) & ~model.rim
    seen &= mesh_squared < hole
    mesh_weight = np.where(seen, (s2 / (s2 + mesh_plane)) ** 2, 0)
    mesh_weight *= MESH_TO_SCAN / (len(model.ids) * s2)
    mesh_energy = np.where(seen, mesh_plane / (s2 + mesh_plane), 1)[:, ~model.rim].mean(axis=1)
    off = np.sum(starts.coefficients**2, axis=1) + np.sum(starts.shape**2, axis=1)
    energy = energy + MESH_TO_SCAN * mesh_energy + PRIOR * off
    return _Pairs(vertex, offset, weight.astype(np.float32), scan_normal, mesh_offset,
                  mesh_weight.astype(np.float32), energy.astype(np.float32))  # fmt: skip


def _vertex_blocks(placed: PlacedBatch, pairs: _Pairs) -> tuple[Single, Single]:
    """Sum pairs into A (S V, 3, 3) and c (S V, 3): the quadratic of each vertex's motion."""
    s, v = placed.vertices.shape[:2]
    at = (pairs.vertex + np.arange(s)[:, None] * v).ravel()
    w = pairs.weight.ravel()
    total = np.bincount(at, w, s * v).astype(np.float32)
    pull = np.stack(
        [np.bincount(at, w * pairs.offset[..., a].ravel(), s * v) for a in range(3)], axis=-1
    ).astype(np.float32)
    n, m = placed.normals.reshape(-1, 3), pairs.scan_normal.reshape(-1, 3)
    mw, offset = pairs.mesh_weight.reshape(-1, 1), pairs.mesh_offset.reshape(-1, 3)
    eye = np.eye(3, dtype=np.float32)
    A = total[:, None, None] * (n[:, :, None] * n[:, None, :] + TANGENTIAL * eye)
    A += mw[:, :, None] * (m[:, :, None] * m[:, None, :] + MESH_TANGENTIAL * eye)
    c = n * np.sum(n * pull, axis=-1, keepdims=True) + TANGENTIAL * pull
    c += mw * (m * np.sum(m * offset, axis=-1, keepdims=True) + MESH_TANGENTIAL * offset)
    return A, c


def step(
    model: CoarseModel, starts: Starts, points: Single, normals: Single, part: Round
) -> tuple[Starts, Single]:
    """One damped Gauss-Newton step of all starts; also their energies before it."""
    placed = model.place(starts)
    pairs = _pair(model, starts, placed, points, normals, part.sigma_m)
    A, c = _vertex_blocks(placed, pairs)
    free = np.array([*range(6), 6 + COMPONENTS]) if part.rigid else np.arange(model.n)
    jacobian = model.rigid_jacobian(placed) if part.rigid else model.jacobian(placed)
    s, p = len(starts), len(free)
    weighted = np.empty_like(jacobian)
    _apply(A, jacobian.reshape(-1, 3, p), weighted.reshape(-1, 3, p))
    flat = jacobian.reshape(s, -1, p).transpose(0, 2, 1)
    hessian = (flat @ weighted.reshape(s, -1, p)).astype(np.float64)
    gradient = (flat @ c.reshape(s, -1, 1))[..., 0].astype(np.float64)
    values = np.concatenate([np.zeros((s, 6)), starts.coefficients, starts.shape], axis=1)[:, free]
    prior = np.where(free >= 6, PRIOR, 0.0)
    k = np.arange(p)
    hessian[:, k, k] += prior
    gradient += prior * values
    diagonal = hessian[:, k, k]
    hessian[:, k, k] += DAMPING * diagonal + 1e-6 * diagonal.max(axis=1, keepdims=True)
    move = np.zeros((s, model.n))
    move[:, free] = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
    return _moved(starts, move), pairs.energy


def _moved(starts: Starts, move: NDArray[np.float64]) -> Starts:
    turn, other = np.abs(move[:, 3:6]).max(axis=1), np.abs(move[:, 6:]).max(axis=1)
    scale = np.minimum(MAX_TURN_RAD / np.maximum(turn, 1e-9), MAX_SD / np.maximum(other, 1e-9))
    small: Single = (move * np.minimum(scale, 1)[:, None]).astype(np.float32)
    rotation = matrix_from_axis_angle(small[:, 3:6]).astype(np.float32) @ starts.rotation
    coefficients = starts.coefficients + small[:, 6 : 6 + COMPONENTS]
    shape = starts.shape + small[:, 6 + COMPONENTS :]
    return Starts(rotation, starts.translation + small[:, :3],
                  np.clip(coefficients, -CLIP_SD, CLIP_SD),
                  np.clip(shape, -CLIP_SHAPE, CLIP_SHAPE))  # fmt: skip


def distinct(vertices: Single, energy: Single, keep: int, apart_m: float) -> NDArray[np.int64]:
    """Return the best ``keep`` starts, none within a mean vertex distance of a better one."""
    chosen: list[int] = []
    for k in np.argsort(energy):
        near = [np.linalg.norm(vertices[k] - vertices[c], axis=-1).mean() for c in chosen]
        if min(near, default=np.inf) > apart_m:
            chosen.append(int(k))
        if len(chosen) == keep:
            break
    return np.array(chosen, dtype=np.int64)


def run(
    model: CoarseModel,
    starts: Starts,
    points: Single,
    normals: Single,
    rounds: Sequence[Round],
    apart_m: float = 0.0015,
) -> tuple[Starts, Single]:
    """Run rounds of steps, keeping the best distinct starts before each; best first."""
    for part in rounds:
        p, n = points[: part.points], normals[: part.points]
        if len(starts) > part.starts:
            energy, placed = energies(model, starts, p, n, part.sigma_m)
            starts = starts.take(distinct(placed.vertices, energy, part.starts, apart_m))
        for _ in range(part.steps):
            starts, _ = step(model, starts, p, n, part)
    last = rounds[-1]
    energy, placed = energies(model, starts, points[: last.points], normals[: last.points],
                              last.sigma_m)  # fmt: skip
    order = distinct(placed.vertices, energy, len(starts), apart_m)
    return starts.take(order), energy[order]


@njit(cache=True, error_model="numpy", fastmath=True)
def _nearest_both_ways(own: Any, scan: Any, vertex: Any, point: Any) -> None:
    """Columns of own (S, 6, V) and rows of scan (N, 6): the nearest of each other's."""
    n_vertices, far = own.shape[2], np.float32(1e30)
    row, best = np.empty(n_vertices, np.float32), np.empty(n_vertices, np.float32)
    which = np.empty(n_vertices, np.int32)
    for s in range(own.shape[0]):
        a, b, c, d, e, f = own[s, 0], own[s, 1], own[s, 2], own[s, 3], own[s, 4], own[s, 5]
        best[:], which[:] = far, 0
        for n in range(scan.shape[0]):
            point_n, p = np.int32(n), scan[n]
            p0, p1, p2, p3, p4, p5 = p[0], p[1], p[2], p[3], p[4], p[5]
            for v in range(n_vertices):
                x, y, z = a[v] - p0, b[v] - p1, c[v] - p2
                i, j, k = d[v] - p3, e[v] - p4, f[v] - p5
                away = x * x + y * y + z * z + i * i + j * j + k * k
                row[v] = away
                nearer = away < best[v]
                best[v] = away if nearer else best[v]
                which[v] = point_n if nearer else which[v]
            least, at = far, 0
            for v in range(n_vertices):
                least = row[v] if row[v] < least else least
            while at < n_vertices - 1 and row[at] != least:
                at += 1
            vertex[s, n] = at
        point[s] = which


@njit(cache=True, error_model="numpy", fastmath=True)
def _apply(blocks: Any, columns: Any, out: Any) -> None:
    """Products of blocks (m, 3, 3) and columns (m, 3, p)."""
    for i in range(len(blocks)):
        for a in range(3):
            x, y, z = blocks[i, a, 0], blocks[i, a, 1], blocks[i, a, 2]
            for q in range(columns.shape[2]):
                out[i, a, q] = x * columns[i, 0, q] + y * columns[i, 1, q] + z * columns[i, 2, q]
