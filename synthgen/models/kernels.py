"""Compiled kernels of the skeleton; the readable truth is :mod:`synthgen.models.reference`.

Rotations, joints and the chain are float64 (they are few, and their errors are amplified along
the chain); per-vertex work (:mod:`synthgen.models.skinning`) is in the type of the packed bases.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

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
                # cosine - 1 would lose the digits of small angles
                w = -2 * math.sin(0.25 * angle) ** 2
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
