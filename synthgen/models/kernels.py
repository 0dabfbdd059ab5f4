"""Compiled forward kernels; the readable truth is :mod:`synthgen.models.reference`.

Rotations, joints and the chain are float64 (they are few, and their errors are amplified along
the chain); per-vertex work is in the type of the packed bases. Skinning blends *differences from
the identity*: v = p + sum w (A - 1) p, which is exact at the zero pose and loses fewer digits.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

_SMALL = 1e-4


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
                w = -squared / 8
            else:
                s = math.sin(angle) / angle
                h = math.sin(0.5 * angle) / angle
                w = -2 * math.sin(0.25 * angle) ** 2
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
    for b in range(rotations.shape[0]):
        rest = joints[b].reshape(-1)
        for i in range(rest.shape[0]):
            rest[i] = 0.0
        for n in range(coefficients.shape[1]):
            c = coefficients[b, n]
            for i in range(rest.shape[0]):
                rest[i] += c * joint_basis[n, i]
        for k in range(parents.shape[0]):
            p, r, g, j = parents[k], rotations[b, k], transforms[b, k], joints[b, k]
            if p < 0:
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
            g[3, 0], g[3, 1], g[3, 2], g[3, 3] = 0.0, 0.0, 0.0, 1.0
            for a in range(3):
                s = skin[b, k]
                s[4 * a + 3] = g[a, 3] - (g[a, 0] * j[0] + g[a, 1] * j[1] + g[a, 2] * j[2])
                for c in range(3):
                    s[4 * a + c] = g[a, c]
                s[4 * a + a] -= 1.0
        for k in range(parents.shape[0]):
            for a in range(3):
                transforms[b, k, a, 3] += moved[b, a]


@njit(cache=True, error_model="numpy", fastmath=True)
def skin_vertices(
    planes: Any, features: Any, start: Any, first: Any, offset: Any, values: Any,
    skin: Any, ids: Any, weights: Any, excess: Any, moved: Any, out: Any,
) -> None:  # fmt: skip
    """Add sparse correctives to planes (B, 3, V), blend, move -> out (B, V, 3).

    features (B, K q); start, first, offset, values as in ``packed.Runs``; a vertex's weights are
    sorted, so that the first zero ends them.
    """
    for b in range(out.shape[0]):
        px, py, pz, A, f = planes[b, 0], planes[b, 1], planes[b, 2], skin[b], features[b]
        tx, ty, tz = moved[b, 0], moved[b, 1], moved[b, 2]
        for v in range(ids.shape[0]):
            x, y, z = px[v], py[v], pz[v]
            for n in range(start[v], start[v + 1]):
                size = (offset[n + 1] - offset[n]) // 3
                g = f[first[n] : first[n] + size]
                m = values[offset[n] : offset[n + 1]]
                for i in range(size):
                    x += m[i] * g[i]
                    y += m[size + i] * g[i]
                    z += m[2 * size + i] * g[i]
            px[v], py[v], pz[v] = x, y, z
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
            out[b, v, 0] = x + (e * x + m00 * x + m01 * y + m02 * z + m03) + tx
            out[b, v, 1] = y + (e * y + m10 * x + m11 * y + m12 * z + m13) + ty
            out[b, v, 2] = z + (e * z + m20 * x + m21 * y + m22 * z + m23) + tz
