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

# Joints whose correctives are worked on together: one AVX-512 or two AVX2 registers of float32.
LANES = 16
# Sums may be reordered, but infinities and NaN keep their meaning.
_FAST = {"contract", "reassoc", "nsz"}


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


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def vertex_rows(
    rows: Any, template: Any, directions: Any, expressions: Any, correctives: Any, reach: Any,
    first: int, ids: Any, weights: Any, parents: Any, betas: Any, psi: Any, numbers: Any,
    axes: Any, column: Any, transforms: Any, joints: Any, of_shape: Any,
    of_expression: Any, vertices: Any, values: Any,
) -> None:  # fmt: skip
    """Posed vertices (m, 3), without translation, and derivatives (m, 3, D) at chosen rows.

    Columns: shape, pose, translation, expression; ``values`` comes in as zeros.
    correctives (V, 3, n, q LANES) and numbers (n, q, 4 LANES), features and their derivatives, are
    laid out as in ``row_bases``; a vertex needs blocks reach[v, 0] to reach[v, 1]; axes
    (K, 3, 3): world, rows by number.
    """
    n_joints = parents.shape[0]
    ns, last = betas.shape[0], values.shape[2] - psi.shape[0]
    lever, held = np.zeros((n_joints, 3)), np.zeros(n_joints)
    touched, T, p = np.zeros(n_joints, np.int64), np.zeros((3, 3)), np.zeros(3)
    change = np.zeros((numbers.shape[0], 3, 4 * LANES), numbers.dtype)
    for r in range(rows.shape[0]):
        v, out = rows[r], values[r]
        lo, hi = reach[v, 0], reach[v, 1]
        p[:] = template[v]
        _add_directions(directions[v], betas, p)
        _add_directions(expressions[v], psi, p)
        for n in range(lo, hi):
            for a in range(3):
                p[a] += _correct(correctives[v, a, n], numbers[n], change[n, a])
        n_touched = _gather(
            ids[v], weights[v], parents, transforms, joints, p, T, lever, held, touched,
            vertices[r],
        )  # fmt: skip
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
        for n in range(lo, hi):
            x, y, z = change[n, 0], change[n, 1], change[n, 2]
            for a in range(3):
                row, t0, t1, t2 = out[a], T[a, 0], T[a, 1], T[a, 2]
                for c in range(3):
                    for s in range(min(LANES, n_joints - first - n * LANES)):
                        i, j = column[first + n * LANES + s, c], c * LANES + s
                        if i >= 0:
                            row[ns + i] += t0 * x[j] + t1 * y[j] + t2 * z[j]
        _coefficient_columns(directions[v], of_shape, ids[v], weights[v], T, out[:, :ns])
        _coefficient_columns(expressions[v], of_expression, ids[v], weights[v], T, out[:, last:])
        for a in range(3):
            out[a, last - 3 + a] = 1.0


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _add_directions(directions: Any, coefficients: Any, p: Any) -> None:
    """Add directions (3, n) times coefficients (n,) to a point."""
    for a in range(3):
        total = 0.0
        for i in range(coefficients.shape[0]):
            total += directions[a, i] * coefficients[i]
        p[a] += total


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _correct(correctives: Any, numbers: Any, change: Any) -> float:
    """Return one component's correction by LANES joints; write its change by their numbers.

    The innermost loop runs over joints and has a constant length, so that it vectorises.
    """
    for s in range(4 * LANES):
        change[s] = 0
    for i in range(numbers.shape[0]):
        d, m = numbers[i], correctives[i * LANES : (i + 1) * LANES]
        for s in range(LANES):
            change[s] += m[s] * d[s]
            change[LANES + s] += m[s] * d[LANES + s]
            change[2 * LANES + s] += m[s] * d[2 * LANES + s]
            change[3 * LANES + s] += m[s] * d[3 * LANES + s]
    total = 0.0
    for s in range(LANES):
        total += change[3 * LANES + s]
    return total


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _gather(
    ids: Any, weights: Any, parents: Any, transforms: Any, joints: Any, p: Any, T: Any,
    lever: Any, held: Any, touched: Any, vertex: Any,
) -> int:  # fmt: skip
    """Skin one point; gather what each joint's subtree holds of it, return how many do.

    Writes the blended rotation T, the vertex, the joints ``touched``, and per joint the weight
    ``held`` (zero on entry) and the weighted position ``lever``.
    """
    n_touched = 0
    T[:] = 0.0
    vertex[:] = 0.0
    for i in range(ids.shape[0]):
        w, j = weights[i], ids[i]
        if w == 0:
            break
        g, rest = transforms[j], joints[j]
        x, y, z = p[0] - rest[0], p[1] - rest[1], p[2] - rest[2]
        sx = w * (g[0, 3] + g[0, 0] * x + g[0, 1] * y + g[0, 2] * z)
        sy = w * (g[1, 3] + g[1, 0] * x + g[1, 1] * y + g[1, 2] * z)
        sz = w * (g[2, 3] + g[2, 0] * x + g[2, 1] * y + g[2, 2] * z)
        vertex[0] += sx
        vertex[1] += sy
        vertex[2] += sz
        for a in range(3):
            for c in range(3):
                T[a, c] += w * g[a, c]
        while j >= 0:
            if held[j] == 0:
                touched[n_touched] = j
                n_touched += 1
                lever[j] = 0.0
            held[j] += w
            lever[j, 0] += sx
            lever[j, 1] += sy
            lever[j, 2] += sz
            j = parents[j]
    return n_touched


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _coefficient_columns(
    directions: Any, of_maps: Any, ids: Any, weights: Any, T: Any, out: Any
) -> None:
    """Write columns (3, n) of coefficients with directions (3, n); of_maps (K, 3, n)."""
    for a in range(3):
        row, t0, t1, t2 = out[a], T[a, 0], T[a, 1], T[a, 2]
        x, y, z = directions[0], directions[1], directions[2]
        for b in range(row.shape[0]):
            row[b] = t0 * x[b] + t1 * y[b] + t2 * z[b]
        for i in range(ids.shape[0]):
            w, offset = weights[i], of_maps[ids[i], a]
            for b in range(row.shape[0]):
                row[b] += w * offset[b]
