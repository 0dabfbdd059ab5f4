"""Compiled forward kernels; the readable truth is :mod:`synthgen.models.reference`.

Rotations, joints and the chain are float64 (they are few, and their errors are amplified along
the chain); per-vertex work is in the type of the packed bases. Skinning blends *differences from
the identity*: v = p + sum w (A - 1) p, which is exact at the zero pose and loses fewer digits.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Samples that are skinned together: one AVX-512 or two AVX2 registers of float32.
TILE = 16
# Vertices whose results are kept until they are written sample by sample.
_BLOCK = 64
_SMALL = 1e-4


@njit(cache=True, error_model="numpy")
def within(limit: float, a: Any, b: Any, c: Any, d: Any) -> bool:
    """Tell whether all numbers of four vectors are finite and at most ``limit`` in size."""
    for values in (a, b, c, d):
        for i in range(values.shape[0]):
            if not abs(values[i]) <= limit:
                return False
    return True


@njit(cache=True, error_model="numpy")
def assemble(
    features: Any, coefficients: Any, dense: Any, moved: Any, rows: Any, joint_features: Any,
    shift: Any,
) -> None:  # fmt: skip
    """Round what the bases are multiplied with: features (B, K q), coefficients (B, n).

    rows (B, r + n): the r dense features, then the coefficients; joint_features (B, K q): all of
    them; shift (B, 3): the translation.
    """
    for b in range(features.shape[0]):
        for i in range(features.shape[1]):
            joint_features[b, i] = features[b, i]
        for i in range(dense.shape[0]):
            rows[b, i] = features[b, dense[i]]
        for i in range(coefficients.shape[1]):
            rows[b, dense.shape[0] + i] = coefficients[b, i]
        for i in range(3):
            shift[b, i] = moved[b, i]


@njit(cache=True, error_model="numpy")
def turn(theta: Any, q: int, rotations: Any, features: Any) -> None:
    """Axis-angle (B, K, 3) -> rotations (B, K, 3, 3) and features (B, K, q), q 9 or 4."""
    for b in range(theta.shape[0]):
        for k in range(theta.shape[1]):
            x, y, z = theta[b, k, 0], theta[b, k, 1], theta[b, k, 2]
            squared = x * x + y * y + z * z
            angle = math.sqrt(squared)
            if angle < _SMALL:
                s = 1 - squared / 6
                h = 0.5 - squared / 48
            else:
                s = math.sin(angle) / angle
                h = math.sin(0.5 * angle) / angle
            c = 2 * h * h
            r = rotations[b, k]
            # identity is added last: differences from it keep all their digits
            d00, d11, d22 = -c * (y * y + z * z), -c * (x * x + z * z), -c * (x * x + y * y)
            r[0, 0], r[0, 1], r[0, 2] = 1 + d00, c * x * y - s * z, c * x * z + s * y
            r[1, 0], r[1, 1], r[1, 2] = c * x * y + s * z, 1 + d11, c * y * z - s * x
            r[2, 0], r[2, 1], r[2, 2] = c * x * z - s * y, c * y * z + s * x, 1 + d22
            f = features[b, k]
            if q == 9:
                f[0], f[1], f[2] = d00, r[0, 1], r[0, 2]
                f[3], f[4], f[5] = r[1, 0], d11, r[1, 2]
                f[6], f[7], f[8] = r[2, 0], r[2, 1], d22
            else:
                w = (
                    -2 * math.sin(0.25 * angle) ** 2
                )  # cos - 1 would lose the digits of small angles
                f[0], f[1], f[2], f[3] = h * x, h * y, h * z, w


@njit(cache=True, error_model="numpy")
def place(
    coefficients: Any, joint_basis: Any, rotations: Any, parents: Any, moved: Any,
    joints: Any, transforms: Any, skin: Any,
) -> None:  # fmt: skip
    """Chain of a batch.

    coefficients (B, 1 + n), joint_basis (1 + n, 3 K), rotations (B, K, 3, 3), moved (B, 3) ->
    rest joints (B, K, 3), world transforms (B, K, 4, 4), skin (B, K, 12): map of rest points
    minus the identity, without the translation.
    """
    offset = np.empty((parents.shape[0], 3))
    for b in range(rotations.shape[0]):
        rest = joints[b].reshape(-1)
        for i in range(rest.shape[0]):
            rest[i] = 0.0
        for n in range(coefficients.shape[1]):
            c = coefficients[b, n]
            for i in range(rest.shape[0]):
                rest[i] += c * joint_basis[n, i]
        for k in range(parents.shape[0]):
            p, r, g, j, s = parents[k], rotations[b, k], transforms[b, k], joints[b, k], skin[b, k]
            # a turn about the joint itself moves rest points by (1 - R) j, exactly 0 at rest
            x = j[0] - (r[0, 0] * j[0] + r[0, 1] * j[1] + r[0, 2] * j[2])
            y = j[1] - (r[1, 0] * j[0] + r[1, 1] * j[1] + r[1, 2] * j[2])
            z = j[2] - (r[2, 0] * j[0] + r[2, 1] * j[1] + r[2, 2] * j[2])
            g[3, 0], g[3, 1], g[3, 2], g[3, 3] = 0.0, 0.0, 0.0, 1.0
            if p < 0:
                offset[k, 0], offset[k, 1], offset[k, 2] = x, y, z
                for a in range(3):
                    g[a, 0], g[a, 1], g[a, 2], g[a, 3] = r[a, 0], r[a, 1], r[a, 2], j[a]
            else:
                up, at = transforms[b, p], joints[b, p]
                dx, dy, dz = j[0] - at[0], j[1] - at[1], j[2] - at[2]
                for a in range(3):
                    u, v, w = up[a, 0], up[a, 1], up[a, 2]
                    for c in range(3):
                        g[a, c] = u * r[0, c] + v * r[1, c] + w * r[2, c]
                    g[a, 3] = up[a, 3] + u * dx + v * dy + w * dz
                    offset[k, a] = offset[p, a] + u * x + v * y + w * z
            for a in range(3):
                s[4 * a], s[4 * a + 1], s[4 * a + 2], s[4 * a + 3] = (
                    g[a, 0], g[a, 1], g[a, 2], offset[k, a]
                )  # fmt: skip
                s[5 * a] = g[a, a] - 1.0
        for k in range(parents.shape[0]):
            for a in range(3):
                transforms[b, k, a, 3] += moved[b, a]


@njit(cache=True, error_model="numpy", fastmath=True)
def skin_samples(
    points: Any, features: Any, start: Any, first: Any, offset: Any, values: Any,
    skin: Any, ids: Any, weights: Any, excess: Any, moved: Any, out: Any,
) -> None:  # fmt: skip
    """Few samples: add sparse correctives to points (B, 3 V), blend, move -> out (B, 3 V).

    features (B, K q); start, first, offset, values as in ``packed.Runs``; a vertex's weights are
    sorted, so that the first zero ends them.
    """
    for b in range(out.shape[0]):
        p, o, A, f = points[b], out[b], skin[b], features[b]
        tx, ty, tz = moved[b, 0], moved[b, 1], moved[b, 2]
        for v in range(ids.shape[0]):
            x, y, z = p[3 * v], p[3 * v + 1], p[3 * v + 2]
            for n in range(start[v], start[v + 1]):
                size = (offset[n + 1] - offset[n]) // 3
                g, o0 = f[first[n] : first[n] + size], offset[n]
                if size == 4:  # one joint's quaternion: a loop would cost more than the sums
                    m = values[o0 : o0 + 12]
                    x += m[0] * g[0] + m[1] * g[1] + m[2] * g[2] + m[3] * g[3]
                    y += m[4] * g[0] + m[5] * g[1] + m[6] * g[2] + m[7] * g[3]
                    z += m[8] * g[0] + m[9] * g[1] + m[10] * g[2] + m[11] * g[3]
                    continue
                mx, my = values[o0 : o0 + size], values[o0 + size : o0 + 2 * size]
                mz = values[o0 + 2 * size : o0 + 3 * size]
                for i in range(size):
                    x += mx[i] * g[i]
                    y += my[i] * g[i]
                    z += mz[i] * g[i]
            p[3 * v], p[3 * v + 1], p[3 * v + 2] = x, y, z
            w, a = weights[v, 0], A[ids[v, 0]]
            m00, m01, m02, m03 = w * a[0], w * a[1], w * a[2], w * a[3]
            m10, m11, m12, m13 = w * a[4], w * a[5], w * a[6], w * a[7]
            m20, m21, m22, m23 = w * a[8], w * a[9], w * a[10], w * a[11]
            for i in range(1, ids.shape[1]):
                w, a = weights[v, i], A[ids[v, i]]
                if w == 0:
                    break
                m00, m01, m02, m03 = m00 + w * a[0], m01 + w * a[1], m02 + w * a[2], m03 + w * a[3]
                m10, m11, m12, m13 = m10 + w * a[4], m11 + w * a[5], m12 + w * a[6], m13 + w * a[7]
                m20, m21, m22, m23 = (
                    m20 + w * a[8], m21 + w * a[9], m22 + w * a[10], m23 + w * a[11]
                )  # fmt: skip
            e = excess[v]
            o[3 * v] = x + (e * x + m00 * x + m01 * y + m02 * z + m03) + tx
            o[3 * v + 1] = y + (e * y + m10 * x + m11 * y + m12 * z + m13) + ty
            o[3 * v + 2] = z + (e * z + m20 * x + m21 * y + m22 * z + m23) + tz


@njit(cache=True, error_model="numpy")
def _tiled(values: Any, out: Any) -> None:
    for b in range(values.shape[0]):
        t, s = b // TILE, b % TILE
        for i in range(values.shape[1]):
            out[t, i * TILE + s] = values[b, i]


def tiled(values: NDArray[Any], n: int) -> NDArray[Any]:
    """Lay (B, ...) values out for :func:`skin_tiles`: (n / TILE, m TILE), samples side by side."""
    flat = values.reshape(len(values), -1)
    out = np.zeros((n // TILE, flat.shape[1] * TILE), values.dtype)
    _tiled(flat, out)
    return out


@njit(cache=True, error_model="numpy", fastmath=True)
def skin_tiles(
    v_first: int, points: Any, F: Any, start: Any, first: Any, offset: Any, values: Any,
    A: Any, ids: Any, weights: Any, excess: Any, moved: Any, out: Any,
) -> None:  # fmt: skip
    """Many samples: as :func:`skin_samples`, for the vertices from ``v_first`` on.

    points (3 n, C), C >= B a multiple of TILE; F (C / TILE, K q TILE) and A (C / TILE, K 12 TILE)
    by :func:`tiled`. Inner loops run over TILE samples and over four weights at once, so that they
    vectorise; a vertex's weights come in fours, filled with zeros.
    """
    n, n_tiles, v_end = out.shape[0], points.shape[1] // TILE, v_first + points.shape[0] // 3
    p, block = np.empty(3 * TILE, out.dtype), np.empty((_BLOCK, 3 * TILE), out.dtype)
    for v0 in range(v_first, v_end, _BLOCK):
        v1 = min(v0 + _BLOCK, v_end)
        for t in range(n_tiles):
            b0 = t * TILE
            for v in range(v0, v1):
                for a in range(3):
                    row = points[3 * (v - v_first) + a]
                    for s in range(TILE):
                        p[a * TILE + s] = row[b0 + s]
                for r in range(start[v], start[v + 1]):
                    _correct(F[t, first[r] * TILE :], values[offset[r] : offset[r + 1]], p)
                q, e = block[v - v0], 1 + excess[v]
                for s in range(3 * TILE):
                    q[s] = e * p[s]
                for i in range(0, ids.shape[1], 4):
                    _add_four(A[t], ids[v, i : i + 4], weights[v, i : i + 4], p, q)
            for s in range(min(TILE, n - b0)):
                o, x, y, z = out[b0 + s], moved[b0 + s, 0], moved[b0 + s, 1], moved[b0 + s, 2]
                for v in range(v0, v1):
                    q = block[v - v0]
                    o[3 * v] = q[s] + x
                    o[3 * v + 1] = q[TILE + s] + y
                    o[3 * v + 2] = q[2 * TILE + s] + z


@njit(cache=True, error_model="numpy", fastmath=True, inline="always")
def _add_four(A: Any, ids: Any, weights: Any, p: Any, q: Any) -> None:
    """Add the motions of points p (3 TILE) by four joints to q (3 TILE)."""
    a, b = A[12 * TILE * ids[0] :], A[12 * TILE * ids[1] :]
    c, d = A[12 * TILE * ids[2] :], A[12 * TILE * ids[3] :]
    wa, wb, wc, wd = weights[0], weights[1], weights[2], weights[3]
    for s in range(TILE):
        x, y, z = p[s], p[TILE + s], p[2 * TILE + s]
        i, j, k, m = s, TILE + s, 2 * TILE + s, 3 * TILE + s
        q[i] += (
            (wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]) * x
            + (wa * a[j] + wb * b[j] + wc * c[j] + wd * d[j]) * y
            + (wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k]) * z
            + (wa * a[m] + wb * b[m] + wc * c[m] + wd * d[m])
        )
        i, j, k, m = 4 * TILE + s, 5 * TILE + s, 6 * TILE + s, 7 * TILE + s
        q[TILE + s] += (
            (wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]) * x
            + (wa * a[j] + wb * b[j] + wc * c[j] + wd * d[j]) * y
            + (wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k]) * z
            + (wa * a[m] + wb * b[m] + wc * c[m] + wd * d[m])
        )
        i, j, k, m = 8 * TILE + s, 9 * TILE + s, 10 * TILE + s, 11 * TILE + s
        q[2 * TILE + s] += (
            (wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]) * x
            + (wa * a[j] + wb * b[j] + wc * c[j] + wd * d[j]) * y
            + (wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k]) * z
            + (wa * a[m] + wb * b[m] + wc * c[m] + wd * d[m])
        )


@njit(cache=True, error_model="numpy", fastmath=True)
def _correct(features: Any, values: Any, p: Any) -> None:
    """Add a run of correctives to points p (3 TILE), four features at a time."""
    size = values.shape[0] // 3
    mx, my, mz = values[:size], values[size : 2 * size], values[2 * size :]
    whole = size - size % 4
    for i in range(0, whole, 4):
        g = features[i * TILE : (i + 4) * TILE]
        x0, x1, x2, x3 = mx[i], mx[i + 1], mx[i + 2], mx[i + 3]
        y0, y1, y2, y3 = my[i], my[i + 1], my[i + 2], my[i + 3]
        z0, z1, z2, z3 = mz[i], mz[i + 1], mz[i + 2], mz[i + 3]
        for s in range(TILE):
            a, b, c, d = g[s], g[TILE + s], g[2 * TILE + s], g[3 * TILE + s]
            p[s] += x0 * a + x1 * b + x2 * c + x3 * d
            p[TILE + s] += y0 * a + y1 * b + y2 * c + y3 * d
            p[2 * TILE + s] += z0 * a + z1 * b + z2 * c + z3 * d
    for i in range(whole, size):
        g = features[i * TILE : (i + 1) * TILE]
        for s in range(TILE):
            p[s] += mx[i] * g[s]
            p[TILE + s] += my[i] * g[s]
            p[2 * TILE + s] += mz[i] * g[s]
