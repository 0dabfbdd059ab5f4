"""Compiled kernels of the vector-Jacobian product: forces on vertices back to the parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", fastmath=True)
def pull_vertices(
    force: Any, points: Any, start: Any, first: Any, offset: Any, values: Any, skin: Any, ids: Any,
    weights: Any, excess: Any, on_maps: Any, on_points: Any, on_features: Any,
) -> None:  # fmt: skip
    """Gradients (B, 3 V) by vertices -> by maps (B, K, 12), rest points (B, 3 V), features.

    ``on_maps`` and ``on_features`` (B, K q, sparse correctives only) come in as zeros; points are
    those that the forward pass left, correctives included.
    """
    for b in range(force.shape[0]):
        p, g, A, maps = points[b], force[b], skin[b], on_maps[b]
        for v in range(ids.shape[0]):
            x, y, z = p[3 * v], p[3 * v + 1], p[3 * v + 2]
            gx, gy, gz = g[3 * v], g[3 * v + 1], g[3 * v + 2]
            e = 1 + excess[v]
            bx, by, bz = e * gx, e * gy, e * gz
            for i in range(ids.shape[1]):
                w = weights[v, i]
                if w == 0:
                    break
                a, m = A[ids[v, i]], maps[ids[v, i]]
                wx, wy, wz = w * gx, w * gy, w * gz
                bx += a[0] * wx + a[4] * wy + a[8] * wz
                by += a[1] * wx + a[5] * wy + a[9] * wz
                bz += a[2] * wx + a[6] * wy + a[10] * wz
                m[0] += wx * x
                m[1] += wx * y
                m[2] += wx * z
                m[3] += wx
                m[4] += wy * x
                m[5] += wy * y
                m[6] += wy * z
                m[7] += wy
                m[8] += wz * x
                m[9] += wz * y
                m[10] += wz * z
                m[11] += wz
            o = on_points[b]
            o[3 * v], o[3 * v + 1], o[3 * v + 2] = bx, by, bz
            for n in range(start[v], start[v + 1]):
                size = (offset[n + 1] - offset[n]) // 3
                f, at = on_features[b, first[n] : first[n] + size], offset[n]
                mx, my = values[at : at + size], values[at + size : at + 2 * size]
                mz = values[at + 2 * size : at + 3 * size]
                for i in range(size):
                    f[i] += bx * mx[i] + by * my[i] + bz * mz[i]


@njit(cache=True, error_model="numpy", fastmath=True)
def pull_rows(basis: Any, on_points: Any, on_rows: Any) -> None:
    """Multiply basis (R, 3 V) by a gradient (3 V,) -> (R,), two rows at a time.

    Reads the basis at the memory's rate, which BLAS' transposed product falls short of.
    """
    n = basis.shape[0]
    for r in range(0, n, 2):
        x, y = basis[r], basis[min(r + 1, n - 1)]
        s, t = basis.dtype.type(0), basis.dtype.type(0)
        for i in range(on_points.shape[0]):
            s += x[i] * on_points[i]
            t += y[i] * on_points[i]
        on_rows[r] = s
        on_rows[min(r + 1, n - 1)] = t if r + 1 < n else s


@njit(cache=True, error_model="numpy")
def pull_skeleton(
    on_maps: Any, on_features: Any, on_joints: Any, transforms: Any, joints: Any, parents: Any,
    omega: Any, feature: Any, column: Any, on_pose: Any, on_rest: Any,
) -> None:  # fmt: skip
    """Gradients by maps (B, K, 12), features (B, K q) and posed joints (B, K, 3) -> pose, rest.

    omega (B, K, 3, 3) and feature (B, K, 3, q) as in ``pose_tangents.Tangents``; on_pose (B, P)
    and on_rest (B, K, 3) come in as zeros.
    """
    n_joints, q = parents.shape[0], feature.shape[3]
    torque, push = np.empty((n_joints, 3)), np.empty((n_joints, 3))
    m = np.empty((3, 3))
    for b in range(on_maps.shape[0]):
        for j in range(n_joints):
            g, rest, at = transforms[b, j], joints[b, j], on_maps[b, j]
            for a in range(3):
                push[j, a] = at[4 * a + 3] + on_joints[b, j, a]
                for c in range(3):
                    m[a, c] = at[4 * a + c] - at[4 * a + 3] * rest[c]
                    on_rest[b, j, c] -= g[a, c] * at[4 * a + 3]
            torque[j] = 0.0
            for c in range(3):
                torque[j, 0] += g[1, c] * m[2, c] - g[2, c] * m[1, c]
                torque[j, 1] += g[2, c] * m[0, c] - g[0, c] * m[2, c]
                torque[j, 2] += g[0, c] * m[1, c] - g[1, c] * m[0, c]
        for j in range(n_joints - 1, -1, -1):
            p = parents[j]
            if p < 0:
                for c in range(3):
                    on_rest[b, j, c] += push[j, c]
                continue
            g, h = transforms[b, j], transforms[b, p]
            x, y, z = g[0, 3] - h[0, 3], g[1, 3] - h[1, 3], g[2, 3] - h[2, 3]
            torque[p, 0] += torque[j, 0] + y * push[j, 2] - z * push[j, 1]
            torque[p, 1] += torque[j, 1] + z * push[j, 0] - x * push[j, 2]
            torque[p, 2] += torque[j, 2] + x * push[j, 1] - y * push[j, 0]
            for c in range(3):
                back = h[0, c] * push[j, 0] + h[1, c] * push[j, 1] + h[2, c] * push[j, 2]
                on_rest[b, j, c] += back
                on_rest[b, p, c] -= back
                push[p, c] += push[j, c]
        for j in range(n_joints):
            p = parents[j]
            for c in range(3):
                if column[j, c] < 0:
                    continue
                o = omega[b, j, c]
                total = 0.0
                for a in range(3):
                    t = torque[j, a]
                    if p >= 0:
                        h = transforms[b, p]
                        t = h[0, a] * torque[j, 0] + h[1, a] * torque[j, 1] + h[2, a] * torque[j, 2]
                    total += o[a] * t
                for i in range(q):
                    total += feature[b, j, c, i] * on_features[b, j * q + i]
                on_pose[b, column[j, c]] += total
