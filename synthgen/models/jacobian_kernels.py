"""Compiled derivative kernels; the readable truth is :mod:`synthgen.models.jacobian_reference`.

A pose number turns everything below its joint about one axis, so a vertex moves by axis x lever,
where the lever gathers what the joint's subtree holds of the vertex, plus the blended rotation of
its correctives' change. Columns of joints that neither carry nor correct a vertex stay zero and
cost nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def world_axes(omega: Any, transforms: Any, parents: Any, axes: Any) -> None:
    """Turn omega (K, 3, 3), rows by number, from the parents' frames into the world."""
    for k in range(parents.shape[0]):
        p = parents[k]
        for c in range(3):
            for a in range(3):
                if p < 0:
                    axes[k, c, a] = omega[k, c, a]
                else:
                    g = transforms[p, a]
                    axes[k, c, a] = (
                        g[0] * omega[k, c, 0] + g[1] * omega[k, c, 1] + g[2] * omega[k, c, 2]
                    )


@njit(cache=True, error_model="numpy")
def joints_by_coefficients(
    joint_basis: Any, transforms: Any, parents: Any, moved: Any, offset: Any
) -> None:
    """Differentiate joints by coefficients, whose rows of the joint basis are (n, K, 3).

    moved (K, 3, n): of the posed joints; offset (K, 3, n): of the maps' translations.
    """
    n = joint_basis.shape[0]
    for k in range(parents.shape[0]):
        p = parents[k]
        for a in range(3):
            for i in range(n):
                j = joint_basis[i]
                if p < 0:
                    moved[k, a, i] = j[k, a]
                else:
                    g = transforms[p, a]
                    moved[k, a, i] = moved[p, a, i] + (
                        g[0] * (j[k, 0] - j[p, 0])
                        + g[1] * (j[k, 1] - j[p, 1])
                        + g[2] * (j[k, 2] - j[p, 2])
                    )
                g = transforms[k, a]
                turned = g[0] * j[k, 0] + g[1] * j[k, 1] + g[2] * j[k, 2]
                offset[k, a, i] = moved[k, a, i] - turned


@njit(cache=True, error_model="numpy")
def joint_rows(transforms: Any, parents: Any, axes: Any, column: Any, at: int, values: Any) -> None:
    """Differentiate posed joints by the pose: values (K, 3, D), pose columns from ``at`` on."""
    for k in range(parents.shape[0]):
        j = parents[k]
        while j >= 0:
            x = transforms[k, 0, 3] - transforms[j, 0, 3]
            y = transforms[k, 1, 3] - transforms[j, 1, 3]
            z = transforms[k, 2, 3] - transforms[j, 2, 3]
            for c in range(3):
                if column[j, c] >= 0:
                    i, a = at + column[j, c], axes[j, c]
                    values[k, 0, i] = a[1] * z - a[2] * y
                    values[k, 1, i] = a[2] * x - a[0] * z
                    values[k, 2, i] = a[0] * y - a[1] * x
            j = parents[j]


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def vertex_rows(
    rows: Any, template: Any, directions: Any, expressions: Any, correctives: Any,
    active_start: Any, active_joint: Any, first: int, ids: Any, weights: Any, parents: Any,
    betas: Any, psi: Any, features: Any, by_number: Any, axes: Any, column: Any,
    transforms: Any, joints: Any, of_shape: Any, of_expression: Any, vertices: Any, values: Any,
) -> None:  # fmt: skip
    """Posed vertices (m, 3), without translation, and derivatives (m, 3, D) at chosen rows.

    Columns: shape, pose, translation, expression; ``values`` comes in as zeros.
    by_number (K, q, 3): derivative of features by each number; axes (K, 3, 3): world.
    """
    n_joints, q = features.shape
    ns, ne, D = betas.shape[0], psi.shape[0], values.shape[2]
    lever, held = np.zeros((n_joints, 3)), np.zeros(n_joints)
    touched = np.zeros(n_joints, np.int64)
    T = np.zeros((3, 3))
    for r in range(rows.shape[0]):
        v, out = rows[r], values[r]
        x, y, z = template[v, 0], template[v, 1], template[v, 2]
        for i in range(ns):
            x += directions[v, 0, i] * betas[i]
            y += directions[v, 1, i] * betas[i]
            z += directions[v, 2, i] * betas[i]
        for i in range(ne):
            x += expressions[v, 0, i] * psi[i]
            y += expressions[v, 1, i] * psi[i]
            z += expressions[v, 2, i] * psi[i]
        for n in range(active_start[v], active_start[v + 1]):
            j = active_joint[n]
            o = (j - first) * q
            for i in range(q):
                f = features[j, i]
                x += correctives[v, 0, o + i] * f
                y += correctives[v, 1, o + i] * f
                z += correctives[v, 2, o + i] * f
        T[:] = 0.0
        n_touched = 0
        vx, vy, vz = 0.0, 0.0, 0.0
        for i in range(ids.shape[1]):
            w = weights[v, i]
            if w == 0:
                break
            j = ids[v, i]
            g, rest = transforms[j], joints[j]
            dx, dy, dz = x - rest[0], y - rest[1], z - rest[2]
            sx = w * (g[0, 3] + g[0, 0] * dx + g[0, 1] * dy + g[0, 2] * dz)
            sy = w * (g[1, 3] + g[1, 0] * dx + g[1, 1] * dy + g[1, 2] * dz)
            sz = w * (g[2, 3] + g[2, 0] * dx + g[2, 1] * dy + g[2, 2] * dz)
            vx, vy, vz = vx + sx, vy + sy, vz + sz
            for a in range(3):
                for c in range(3):
                    T[a, c] += w * g[a, c]
                for b in range(ns):
                    out[a, b] += w * of_shape[j, a, b]
                for b in range(ne):
                    out[a, D - ne + b] += w * of_expression[j, a, b]
            while j >= 0:
                if held[j] == 0:
                    touched[n_touched] = j
                    n_touched += 1
                    lever[j, 0], lever[j, 1], lever[j, 2] = 0.0, 0.0, 0.0
                held[j] += w
                lever[j, 0] += sx
                lever[j, 1] += sy
                lever[j, 2] += sz
                j = parents[j]
        vertices[r, 0], vertices[r, 1], vertices[r, 2] = vx, vy, vz
        for n in range(n_touched):
            j = touched[n]
            x = lever[j, 0] - held[j] * transforms[j, 0, 3]
            y = lever[j, 1] - held[j] * transforms[j, 1, 3]
            z = lever[j, 2] - held[j] * transforms[j, 2, 3]
            held[j] = 0.0
            for c in range(3):
                if column[j, c] >= 0:
                    i, a = ns + column[j, c], axes[j, c]
                    out[0, i] = a[1] * z - a[2] * y
                    out[1, i] = a[2] * x - a[0] * z
                    out[2, i] = a[0] * y - a[1] * x
        _correct(out, ns, v, correctives, active_start, active_joint, first, by_number, column, T)
        for a in range(3):
            out[a, D - ne - 3 + a] = 1.0
            t0, t1, t2 = T[a, 0], T[a, 1], T[a, 2]
            for b in range(ns):
                out[a, b] += (
                    t0 * directions[v, 0, b] + t1 * directions[v, 1, b] + t2 * directions[v, 2, b]
                )
            for b in range(ne):
                out[a, D - ne + b] += (
                    t0 * expressions[v, 0, b]
                    + t1 * expressions[v, 1, b]
                    + t2 * expressions[v, 2, b]
                )


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"}, inline="always")
def _correct(
    out: Any, ns: int, v: int, correctives: Any, active_start: Any, active_joint: Any, first: int,
    by_number: Any, column: Any, T: Any,
) -> None:  # fmt: skip
    """Add the blended change of a vertex's correctives to its pose columns."""
    q = by_number.shape[1]
    for n in range(active_start[v], active_start[v + 1]):
        j = active_joint[n]
        o = (j - first) * q
        e = by_number[j]
        a0, a1, a2 = 0.0, 0.0, 0.0
        b0, b1, b2 = 0.0, 0.0, 0.0
        c0, c1, c2 = 0.0, 0.0, 0.0
        for i in range(q):
            p, s, t = e[i, 0], e[i, 1], e[i, 2]
            m0, m1, m2 = (
                correctives[v, 0, o + i],
                correctives[v, 1, o + i],
                correctives[v, 2, o + i],
            )
            a0, a1, a2 = a0 + m0 * p, a1 + m1 * p, a2 + m2 * p
            b0, b1, b2 = b0 + m0 * s, b1 + m1 * s, b2 + m2 * s
            c0, c1, c2 = c0 + m0 * t, c1 + m1 * t, c2 + m2 * t
        for a in range(3):
            row, t0, t1, t2 = out[a], T[a, 0], T[a, 1], T[a, 2]
            if column[j, 0] >= 0:
                row[ns + column[j, 0]] += t0 * a0 + t1 * a1 + t2 * a2
            if column[j, 1] >= 0:
                row[ns + column[j, 1]] += t0 * b0 + t1 * b1 + t2 * b2
            if column[j, 2] >= 0:
                row[ns + column[j, 2]] += t0 * c0 + t1 * c1 + t2 * c2
